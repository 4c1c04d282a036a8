"""The paper's own numbers, as far as they could be read, and where from. Its tables as a whole could not be."""

EARLY_BIRD_D5_MEAN_M, RTABMAP_D5_MEAN_M = 5.69, 9.239
SOURCES = (
    "D5's ATE: Early Bird's table of trajectory errors as cited by the notes on the authors' repository "
    "UditSinghParihar/VPR_Loop_Closure (mean, rows paired, aligned by the first 70 poses).",
    "NetVLAD's best recall is about 70, and the ATE after over RTAB-Map's 1/3.6 to 1/8 in its simulated worlds: at "
    "second hand; the tables themselves could not be read.",
    "A dash: the number is not known to us.",
)
NETVLAD_BEST, ATE_SHARE = "about 70 (its best)", "1/3.6 to 1/8 of RTAB-Map's"
