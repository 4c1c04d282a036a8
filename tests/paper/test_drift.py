import pytest

from ebjax.paper.drift import ODOMETRY, OFF, OURS, measure_d5
from ebjax.slam.config import PipelineConfig


@pytest.mark.slow
def test_the_real_graph_gives_the_published_path(data):
    rows = measure_d5(data("d5_pose_graph"), PipelineConfig())
    published = rows["published Early Bird"]
    for key in ("ate_rmse_m", "ate_mean_m"):
        assert rows[OURS][key] == pytest.approx(published[key], abs=1e-3)
        assert rows[OFF][key] == pytest.approx(rows[ODOMETRY][key])
    assert published["ate_mean_m"] == pytest.approx(5.69, abs=0.02)
    assert rows[OURS]["share_of_odometry"] < 0.5
