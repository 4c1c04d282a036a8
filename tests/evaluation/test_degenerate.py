import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.evaluation.degenerate import undefined, unsolvable
from ebjax.evaluation.trajectory import ALIGNMENTS, ate

SPACE = ("se3", "sim3")


def reasons(reference, estimate):
    return {name: reason for name in ALIGNMENTS if (reason := undefined(reference, estimate, name))}


def line(count, length=10.0):
    direction = Rotation.from_rotvec([0.3, 0.2, 1.0]).as_matrix()[:, 0]
    return np.linspace(0, length, count)[:, None] * direction[None, :] + np.array([[5.0, -3.0, 1.0]])


@pytest.mark.parametrize("count", [5, 41, 1000])
@pytest.mark.parametrize("decimals", [4, 6, 15])
def test_a_straight_line_has_no_turn_about_itself(count, decimals):
    reference = line(count).round(decimals)
    for estimate in (reference, 2 * reference, 1.02 * line(count)[:, [1, 0, 2]]):
        found = reasons(reference, estimate)
        assert set(found) == set(SPACE) and all("straight line" in reason for reason in found.values())
        assert np.isfinite(ate(reference, estimate, "se2")["rmse"])
        with pytest.raises(ValueError, match="alignment se3 is undefined: the reference is a straight line"):
            ate(reference, estimate, "se3")


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count, noise", [(8, 0.02), (41, 0.02), (41, 0.1), (1000, 0.05)])
def test_noise_on_a_straight_line_is_no_path(seed, count, noise):
    rng = np.random.default_rng(seed)
    reference, estimate = (line(count) + rng.normal(0, noise, (count, 3)) for _ in range(2))
    assert set(reasons(reference, estimate)) == set(SPACE)
    flat = np.array([[1, 1, 0.0]])
    assert set(reasons(reference * flat, estimate * flat)) == set(SPACE)


def test_drift_across_a_straight_line_is_no_path():
    reference = line(200) + np.random.default_rng(0).normal(0, 0.003, (200, 3))
    bow = reference + np.linspace(-1, 1, 200)[:, None] ** 2 * np.array([[0, 0, 0.5]])
    assert set(reasons(reference, bow)) == set(SPACE)


@pytest.mark.parametrize("count", [10, 60, 2000])
@pytest.mark.parametrize("width", [0.3, 1.0, 20.0])
def test_narrow_paths_that_both_share_are_defined(count, width):
    """A corridor of 20 m, 0.3 m wide and more, planar, with an error of a centimetre."""
    rng = np.random.default_rng(count)
    share = np.linspace(0, 1, count)[:, None]
    reference = np.concatenate([20 * share, width * np.sin(7 * share), 0 * share], axis=1)
    estimate = reference + rng.normal(0, 0.01, reference.shape) * np.array([[1, 1, 0]])
    assert reasons(reference, estimate) == {}
    assert reasons(reference, 0.1 * estimate) == {}


@pytest.mark.parametrize("count", [2, 3])
def test_few_positions_hide_the_error_of_a_fit_in_space(count):
    reference = np.random.default_rng(1).normal(size=(count, 3))
    estimate = reference + 0.1
    found = reasons(reference, estimate)
    assert set(found) == set(SPACE) and f"{count} distinct positions" in found["se3"]
    # Rows at one place are one position.
    assert set(reasons(reference.repeat(9, axis=0), estimate.repeat(9, axis=0))) == set(SPACE)


@pytest.mark.parametrize("offset", [0.0, 5e5])
def test_a_robot_that_stands_still_has_no_alignment(offset):
    moving = np.random.default_rng(2).normal(size=(30, 3))
    still = np.full((30, 3), offset)
    assert reasons(still, moving) == dict.fromkeys(ALIGNMENTS[1:], "") | {
        name: f"the reference's poses never move{' in x and y' if name == 'se2' else ''}" for name in ALIGNMENTS[1:]
    }
    assert "the trajectory's poses never move" in reasons(moving, still)["se3"]
    assert ate(still, moving, "none")["rmse"] > 0
    climb = np.zeros((30, 3))
    climb[:, 2] = np.arange(30)
    assert "never move in x and y" in reasons(moving, climb)["se2"]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 40.0])
def test_a_scale_that_collapses_is_named(scale):
    rng = np.random.default_rng(3)
    reference, estimate = rng.normal(size=(2000, 3)), scale * rng.normal(size=(2000, 3))
    assert "the scale collapses" in reasons(reference, estimate)["sim3"]
    with pytest.raises(ValueError, match="sim3 is undefined: the scale collapses"):
        ate(reference, estimate, "sim3")
    assert reasons(reference, scale * reference + 0.1 * estimate) == {}


def test_a_unit_of_positions_is_a_scale():
    millimetres = 1e3 * np.cumsum(np.random.default_rng(4).normal(size=(50, 3)), axis=0)
    assert unsolvable(millimetres / 1e3, millimetres, "sim3") is None
    assert ate(millimetres / 1e3, millimetres, "sim3")["rmse"] < 1e-9
