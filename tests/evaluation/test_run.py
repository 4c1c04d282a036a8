import numpy as np
import pytest

from ebjax.evaluation.run import closure_errors, closure_summary, reason_counts, spread_rows, trajectory_errors


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


def test_reasons_are_counted_without_their_numbers():
    counts = reason_counts(["kept", "12 inliers, fewer than 20", "7 inliers, fewer than 20", "kept", "kept"])
    assert counts == {"kept": 3, "inliers fewer than": 2}
    assert reason_counts([]) == {}


def test_rows_are_spread():
    np.testing.assert_array_equal(spread_rows(np.arange(3), 5), [0, 1, 2])
    np.testing.assert_array_equal(spread_rows(np.arange(101), 3), [0, 50, 100])
