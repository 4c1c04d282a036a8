import numpy as np

from ebjax.slam.world import matrices, planar


def test_planar_and_back():
    rng = np.random.default_rng(0)
    poses = np.cumsum(rng.normal(0, 0.4, (50, 3)), 0)
    back = planar(matrices(poses))
    np.testing.assert_allclose(np.diff(back, axis=0), np.diff(poses, axis=0), atol=1e-12)


def test_roll_and_pitch_are_carried_over():
    rng = np.random.default_rng(1)
    tilt = matrices(rng.normal(0, 1, (5, 3)))
    c, s = np.cos(0.05), np.sin(0.05)
    tilt[:, :3, :3] = tilt[:, :3, :3] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    moved = matrices(planar(tilt) + np.array([1.0, 2.0, 0.3]), like=tilt)
    turn = matrices(np.array([[0.0, 0.0, 0.3]]))[0]
    np.testing.assert_allclose(moved[:, :3, :3], turn[:3, :3] @ tilt[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(moved[:, :2, 3], tilt[:, :2, 3] + np.array([1.0, 2.0]), atol=1e-12)


def test_missing_truth_stays_missing():
    poses = matrices(np.zeros((3, 3)))
    poses[1] = np.nan
    assert np.isnan(planar(poses)[1]).all()
    assert np.isfinite(planar(poses)[[0, 2]]).all()
