import numpy as np
import pytest

from ebjax.io.trajectory import write_tum
from ebjax.viz.run_errors import frames_and_truth


@pytest.mark.parametrize("start, scale", [(0.0, 1e3), (1.4e9, 1e3), (1.4e9, 1e9), (1.4e9, 1.0)])
def test_truth_in_another_unit_is_converted_and_said(tmp_path, start, scale):
    times = start + np.arange(50) * 0.1
    poses = np.tile(np.eye(4), (50, 1, 1))
    poses[:, 0, 3] = np.arange(50) * 0.05
    write_tum(tmp_path / "trajectory.tum", times, poses)
    write_tum(tmp_path / "truth.txt", times * scale, poses)
    found, truth, notes = frames_and_truth(tmp_path, str(tmp_path / "truth.txt"), 0.02)
    np.testing.assert_allclose(found, times, atol=1e-6)
    np.testing.assert_allclose(truth[:, 0], poses[:, 0, 3], atol=1e-5)
    assert len(notes) == (scale != 1) and all("truth.txt: " in note and "read as seconds" in note for note in notes)
