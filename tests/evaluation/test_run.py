import numpy as np
import pytest

from ebjax.evaluation.run import (
    closure_errors,
    closure_summary,
    drift,
    reason_counts,
    spread_rows,
    trajectory_errors,
)


def test_errors_of_a_shifted_closure():
    truth_i, truth_j = np.array([[1.0, 2.0, 0.5]] * 2), np.array([[3.0, 1.0, -2.0]] * 2)
    c, s = np.cos(0.5), np.sin(0.5)
    exact = np.array([c * 2 - s * 1, -s * 2 - c * 1, -2.5])
    measured = np.stack([exact, exact + np.array([0.03, 0.04, 0.1 + 2 * np.pi])])
    errors = closure_errors(truth_i, truth_j, measured)
    np.testing.assert_allclose(errors, [[0, 0], [0.05, 0.1]], atol=1e-12)
    summary = closure_summary(errors, np.array([True, True]))["closures_against_truth"]
    assert (summary["checked"], summary["within_5cm_1deg"]) == (2, 1)
    assert closure_summary(errors, np.array([False, False])) == {}


def test_trajectory_errors_leave_out_frames_without_truth():
    path = np.stack([np.arange(10.0), np.zeros(10), np.zeros(10)], 1)
    truth = path + np.array([5.0, 1.0, 0.0])
    truth[3] = np.nan
    before = path.copy()
    before[:, 1] = [0.1, -0.1] * 5
    result = trajectory_errors(truth, before, path)["ate_rmse_m"]
    assert result["frames"] == 9
    assert result["after"] == pytest.approx(0, abs=1e-12)
    assert result["before"] == pytest.approx(0.1, rel=0.1)
    assert trajectory_errors(np.full((10, 3), np.nan), before, path) == {}


def test_reasons_are_counted_whatever_their_numbers():
    counts = reason_counts(["kept", "12 inliers, fewer than 20", "7 inliers, fewer than 20", "kept", "kept"])
    assert counts == {"kept": 3, "… inliers, fewer than 20": 2}
    assert reason_counts([]) == {}


def test_rows_are_spread():
    np.testing.assert_array_equal(spread_rows(np.arange(3), 5), [0, 1, 2])
    np.testing.assert_array_equal(spread_rows(np.arange(101), 3), [0, 50, 100])


def winding(count=601):
    """A path of 60 m that winds, 0.1 m a frame."""
    heading = 0.8 * np.sin(np.arange(count) / 40)
    steps = 0.1 * np.stack([np.cos(heading), np.sin(heading)], 1)[:-1]
    return np.concatenate([np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)]), heading[:, None]], 1)


@pytest.mark.parametrize("straight", [True, False])
def test_a_path_that_is_one_percent_too_long_drifts_one_percent(straight):
    truth = winding() * [1.0, not straight, not straight]
    found = drift(truth, truth * [1.01, 1.01, 1.0])
    # Stretches are as long as the way, errors are shares of the distance between their ends.
    assert found["position_share"] == pytest.approx(0.01, rel=0.02 if straight else 0.1)
    assert found["heading_deg_per_m"] == pytest.approx(0, abs=1e-12)
    assert found["stretch_m"] == 10.0


def test_drift_does_not_depend_on_where_a_path_begins():
    truth = winding()
    c, s = np.cos(2.0), np.sin(2.0)
    moved = np.concatenate([truth[:, :2] @ np.array([[c, s], [-s, c]]) + [5.0, -3.0], truth[:, 2:] + 2.0], 1)
    found = drift(truth, moved)
    assert found["position_share"] == pytest.approx(0, abs=1e-12)
    assert found["heading_deg_per_m"] == pytest.approx(0, abs=1e-12)


def test_a_path_that_bends_drifts_in_heading():
    truth = np.stack([0.1 * np.arange(401), np.zeros(401), np.zeros(401)], 1)
    heading = np.radians(0.2) * truth[:, 0]
    steps = 0.1 * np.stack([np.cos(heading), np.sin(heading)], 1)[:-1]
    bent = np.concatenate([np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)]), heading[:, None]], 1)
    found = drift(truth, bent)
    assert found["heading_deg_per_m"] == pytest.approx(0.2, rel=0.02)
    # Sideways by half of the angle turned over the stretch.
    assert found["position_share"] == pytest.approx(np.radians(0.2) * 10 / 2, rel=0.03)


def test_drift_leaves_out_frames_without_truth_and_needs_a_stretch():
    truth = winding()
    path = truth * [1.01, 1.01, 1.0]
    full = drift(truth, path)
    truth[::7] = np.nan
    holed = drift(truth, path)
    assert holed["stretches"] < full["stretches"]
    assert holed["position_share"] == pytest.approx(full["position_share"], rel=0.05)
    assert drift(truth[:90], path[:90]) == {}
    assert drift(np.full_like(truth, np.nan), path) == {}
    assert drift(truth[:90], path[:90], 2.0)["stretch_m"] == 2.0


@pytest.mark.parametrize("still", ["truth", "before", "after"])
def test_trajectory_errors_of_a_robot_that_stands_are_undefined(still):
    moving = np.stack([np.arange(10.0), np.arange(10.0) ** 2, 0.1 * np.arange(10.0)], axis=1)
    paths = {name: np.zeros((10, 3)) if name == still else moving for name in ("truth", "before", "after")}
    found = trajectory_errors(paths["truth"], paths["before"], paths["after"])
    assert found["ate_rmse_m"] is None and "never move" in found["ate_undefined"]
