"""NEES of matches: 2 where covariances are right, whatever their scale; mismatches and a wrong motion are told."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.command import run
from ebjax.features.settle import FREEDOM, PairMatches
from ebjax.geometry.camera import camera_over_floor, project
from ebjax.paper.__main__ import KeypointsConfig
from ebjax.paper.__main__ import keypoints as command
from ebjax.paper.keypoints import INSIDE, placed

CAMERA = camera_over_floor(380.0, 380.0, 319.5, 239.5, 640, 480, 0.54, np.radians(19), 0.01, 0.27)
FACING = np.array([3.4, 0.1, np.pi - 0.04])
COUNT = 4000


def matches(spread, true_spread, wrong=0):
    """Pixels of floor points seen from two places, off by Student's t of `true_spread`, px^2; some are mismatched."""
    random = np.random.default_rng(3)
    points_j = random.uniform([1.0, -0.7], [2.9, 0.7], (COUNT, 2))
    c, s = np.cos(FACING[2]), np.sin(FACING[2])
    points_i = points_j @ np.array([[c, s], [-s, c]]) + FACING[:2]
    i, j = (np.array(project(CAMERA, np.pad(p, [(0, 0), (0, 1)]))[0]) for p in (points_i, points_j))
    heavy = np.sqrt(FREEDOM / random.chisquare(FREEDOM, (COUNT, 1)))
    i += heavy * random.standard_normal((COUNT, 2)) @ np.linalg.cholesky(true_spread).T
    i[:wrong] += random.uniform(-6, 6, (wrong, 2))
    none = jnp.zeros((COUNT, 3))
    told = jnp.broadcast_to(jnp.asarray(spread), (COUNT, 2, 2))
    return PairMatches(jnp.asarray(i), jnp.asarray(j), none, none, jnp.ones(COUNT, bool), jnp.asarray(FACING), told)


@pytest.mark.parametrize("scale", [0.1, 1.0, 30.0])
def test_right_covariances_have_two_degrees_of_freedom(scale):
    true = 0.001 * np.array([[1.0, 0.6], [0.6, 2.0]])
    found = placed(matches(scale * true, true), CAMERA, FACING, FACING, 0.03)
    assert found.matches > 0.99 * COUNT
    assert found.nees == pytest.approx(2, abs=0.6) and found.inside == pytest.approx(INSIDE, abs=0.02)


def test_wrong_ones_are_told():
    true = 0.001 * np.diag([1.0, 25.0])
    right = placed(matches(true, true), CAMERA, FACING, FACING, 0.03)
    round_ones = placed(matches(0.005 * np.eye(2), true), CAMERA, FACING, FACING, 0.03)
    assert round_ones.inside < right.inside - 0.015
    assert placed(matches(true, true, wrong=200), CAMERA, FACING, FACING, 0.03).nees > 3 * right.nees
    # A motion that is off by 5 mm: matches say one thing, the truth another.
    off = placed(matches(true, true), CAMERA, FACING, FACING + np.array([0.005, 0, 0]), 0.03)
    assert off.nees > 3 * right.nees and off.error_m > 0.004


def test_no_match_near_the_truth_is_no_pair():
    true = 0.01 * np.eye(2)
    assert placed(matches(true, true), CAMERA, FACING, FACING + np.array([5.0, 0, 0]), 0.03) is None


@pytest.mark.slow
def test_command(small_run, tmp_path, capsys):
    run(command, KeypointsConfig, [str(small_run), "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert "| blotches, steps |" in printed and "| blotches, closures |" in printed
    kinds = json.loads((tmp_path / "keypoints.json").read_text())["runs"]["blotches"]
    for mean in kinds.values():
        assert mean["pairs"] >= 3 and mean["matches"] > 50 * mean["pairs"]
        assert mean["nees"] < 10 and mean["error_m"] < 0.002
    assert printed.split("\n\n")[0] in (tmp_path / "keypoints.md").read_text()
    (small_run / "groundtruth.txt").rename(tmp_path / "truth")
    try:
        with pytest.raises(SystemExit, match="2"):
            run(command, KeypointsConfig, [str(small_run), "--out", str(tmp_path)])
    finally:
        (tmp_path / "truth").rename(small_run / "groundtruth.txt")
    assert "needs the truth" in capsys.readouterr().err
