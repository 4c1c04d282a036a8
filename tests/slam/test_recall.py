"""What is verified, on a corridor of 20 m that is driven there and back."""

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import FloorView
from ebjax.geometry.planar import wrapped
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.config import PipelineConfig
from ebjax.slam.recall import Alike, comparable_rows, filled, not_ranked, worth_verifying
from ebjax.slam.walked import Walked
from ebjax.views.run_view import RunView

FLOOR = FloorView(0.5, 1.7, -0.6, 0.6, 0.01)
VIEW = RunView(jnp.eye(3), jnp.asarray(FLOOR.floor_from_view), jnp.ones(FLOOR.size, bool))
OUT = np.stack([0.25 * np.arange(81), np.zeros(81), np.zeros(81)], 1)
PATH = np.concatenate([OUT, OUT[::-1] + np.array([0, 0.2, np.pi])])
STEPS = WheelErrors(translation=0.01, heading_deg_per_sqrt_m=0.2).step_covariance(PATH)
ROW = 130
"""On the way back, 12.25 m from the far end."""


def walked(piece=0):
    return Walked(PATH, STEPS, np.where(np.arange(len(PATH)) < 40, piece, 0))


def ranked(*rows):
    """Earlier rows, alternately in the same direction and in the opposite one."""
    j = np.array(rows, int)
    return Alike(j, np.arange(len(j)) % 2 == 1, np.linspace(0.1, 0.5, len(j)))


def asked(chosen, path=None, verify=2):
    row, path = ROW, path or walked()
    comparable = comparable_rows(np.arange(row + 1.0), path.travelled[: row + 1], 0, 5.0, 4.0)
    return not_ranked(chosen, row, comparable, path, VIEW, PipelineConfig(verify=verify)), comparable


def test_only_rows_that_odometry_allows_are_asked_for():
    (same, opposing), (first, second) = asked(ranked())
    centres = PATH[:, :2] + VIEW.centre_m[0] * np.stack([np.cos(PATH[:, 2]), np.sin(PATH[:, 2])], 1)
    near = np.linalg.norm(centres - centres[ROW], axis=1)[:ROW] <= VIEW.extent_m
    facing = np.abs(wrapped(PATH[:ROW, 2] - PATH[ROW, 2])) > np.pi / 2
    rows = np.arange(ROW)
    # All that overlap, none that is far away.
    assert opposing[near & facing & (rows < second)].all() and not opposing[~facing].any()
    assert not opposing[60:].any()
    assert not same[facing].any() and not same[first:].any()


def test_a_direction_that_has_enough_is_not_asked_again():
    (_, opposing), _ = asked(ranked(0, 30))
    (same, none), _ = asked(ranked(0, 30, 1, 31))
    assert opposing.any() and not opposing[30] and not none.any() and not same.any()


def test_between_two_pieces_of_path_nothing_is_known():
    (_, opposing), _ = asked(ranked(), walked(piece=1))
    assert not opposing[:40].any()


@pytest.mark.parametrize("verify", [1, 2, 5])
def test_the_ranking_of_all_is_filled_up(verify):
    """The first of the ranking are places that look alike; the true one comes behind them."""
    true = int(np.argmin(np.abs(OUT[:, 0] - (PATH[ROW, 0] - 2 * VIEW.centre_m[0]))))
    ranking = Alike(np.array([60, 61, 62, 63]), np.array([True, True, False, True]), np.linspace(0.1, 0.2, 4))
    path, config = walked(), PipelineConfig(verify=verify)
    chosen = worth_verifying(ranking, ROW, path, VIEW, config)
    assert not len(chosen.j)
    (_, opposing), _ = asked(chosen, path, verify)
    assert opposing[true]
    rows = np.array([true, *(np.flatnonzero(opposing)[:8])])
    found = filled(chosen, Alike(rows, np.ones(len(rows), bool), np.linspace(0.2, 0.4, len(rows))), verify)
    assert len(found.j) == verify and found.j[0] == true and found.opposing.all()


def test_what_was_chosen_stays_first():
    chosen, others = ranked(7, 8), ranked(9, 10, 11, 12)
    found = filled(chosen, others, 2)
    assert found.j.tolist() == [7, 8, 9, 10] and found.opposing.tolist() == [False, True, False, True]
