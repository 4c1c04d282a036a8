"""The corrected path beside the drive: large graphs are solved whole from time to time, and in part in between."""

import dataclasses

import numpy as np
import pytest

from ebjax.geometry.planar import between, compose
from ebjax.posegraph.lm import solve
from ebjax.slam import correct
from ebjax.slam.correct import Corrector, touching
from ebjax.slam.graph import graph_so_far
from ebjax.slam.measured import Measured

LAP, STEP_M = 40, 0.5


@pytest.fixture(scope="module")
def laps():
    """Where 240 keyframes of a robot going round are, the path of its steps, their covariance, and the closures."""
    rng = np.random.default_rng(4)
    turn = 2 * np.pi * np.arange(240) / LAP
    true = np.stack([3 * np.sin(turn), 3 * (1 - np.cos(turn)), turn], 1)
    sigma = np.array([5e-3, 5e-3, 3e-3])
    steps = between(true[:-1], true[1:]) + sigma * rng.normal(size=(239, 3))
    path = np.zeros((240, 3))
    for k, step in enumerate(steps):
        path[k + 1] = compose(path[k], step)
    i = np.arange(LAP, 240)
    j = i - LAP
    count, many = len(i), np.ones(len(i), int)
    seen = between(true[i], true[j]) + 1e-3 * rng.normal(size=(count, 3))
    closures = Measured(i, j, many < 0, 0.0 * many, many, many, seen, np.tile(1e-6 * np.eye(3), (count, 1, 1)))
    return true, path, np.tile(np.diag(sigma**2), (239, 1, 1)), closures


def graph_of(laps, rows):
    _, path, covariance, closures = laps
    known = closures.rows(np.flatnonzero(closures.i < rows))
    piece = np.zeros(rows, int)
    return graph_so_far(path[:rows], covariance[: rows - 1], piece, path[:rows], known)


def test_part_of_a_graph_is_the_graph_with_the_rest_standing_still(laps):
    whole = graph_of(laps, 200)
    part, rows = touching(whole, 150)
    found = solve(dataclasses.replace(whole, fixed=np.arange(200) < 150), rtol=1e-20).poses
    np.testing.assert_array_equal(rows, np.r_[110:200])
    np.testing.assert_allclose(solve(part, rtol=1e-20).poses, np.asarray(found)[rows], atol=1e-9)


def test_all_of_a_graph_is_the_graph(laps):
    whole = graph_of(laps, 120)
    part, rows = touching(whole, 0)
    np.testing.assert_array_equal(rows, np.arange(120))
    np.testing.assert_array_equal(part.i, whole.i)
    assert not np.asarray(part.fixed).any()


@pytest.mark.parametrize("large", [60, 1024])
def test_keyframes_are_where_they_are(laps, large, monkeypatch):
    """In part or whole each time, to 3 cm, where the path of the steps errs by more than 20."""
    monkeypatch.setattr(correct, "LARGE", large)
    true, path, *_ = laps
    firsts, solved = [], correct.touching
    monkeypatch.setattr(correct, "touching", lambda graph, first: firsts.append(first) or solved(graph, first))
    corrector = Corrector(len(path))
    for rows in range(1, 241):

        def begin(rows=rows):
            return lambda thought: (dataclasses.replace(graph_of(laps, rows), poses=thought), np.ones(rows, bool))

        if corrector.take(rows, begin, path[:rows]):
            assert corrector.in_map(0) and not corrector.in_map(corrector.settled)
    poses = corrector.poses(path)
    corrector.close()
    off = np.linalg.norm((poses - true)[: corrector.settled, :2], axis=1)
    assert np.linalg.norm((path - true)[:, :2], axis=1).max() > 0.2
    assert off.max() < 0.03
    assert (max(firsts) > 0) == (large == 60)
