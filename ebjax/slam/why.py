"""Why nothing was kept: one sentence with the commonest reason and what to do about it."""

from collections.abc import Sequence

from ebjax.slam.believe import CONTRADICTED, THINNED

REMEDIES = (
    ("inlier", "their floor shows too little that is its own; look at floor_map.png, or try --extractor rootsift"),
    ("uncertain", "too few points of the floor are seen; give a wider --view, or a mount that looks farther ahead"),
    ("contradicts odometry", "check T_base_camera, or let the odometry err more: --odometry.heading-deg-per-sqrt-m"),
    ("contradicts the", "they do not agree with each other: a floor that repeats; see loop_closures.csv"),
    ("no other closure", "one alone is not believed: --min-agreeing 1 takes it"),
    ("no measurement", "the depth shows too little floor: run with --depth none"),
)


def why_nothing(reasons: Sequence[str], candidates: int) -> str:
    """The sentence.

    Args:
      reasons: of every candidate.
      candidates: how many there were.
    """
    if not candidates:
        return (
            "no loop closure: no view was compared with an earlier one; the run must come back to floor that it has "
            "seen at least --min-gap-s earlier"
        )
    counts = {key: sum(key in reason for reason in reasons) for key, _ in REMEDIES}
    key = max(counts, key=lambda k: counts[k])
    most = {"inlier": "too few matches agree", "contradicts the": "contradicts the others"}.get(key, key)
    if not counts[key]:
        rest = [reason for reason in reasons if reason not in (THINNED, CONTRADICTED)]
        return f"no loop closure: of {candidates} candidates none was kept; see loop_closures.csv" + (
            f" ({rest[0]})" if rest else ""
        )
    return f"no loop closure: of {candidates} candidates {counts[key]}: {most}; {dict(REMEDIES)[key]}"
