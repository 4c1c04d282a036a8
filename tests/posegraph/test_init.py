from dataclasses import replace

import numpy as np
import pytest

from ebjax.geometry.lie import GROUPS
from ebjax.posegraph import init


def distance(group, a, b):
    lie = GROUPS[group]
    return abs(lie.log(lie.compose(lie.inverse(a), b))).max()


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
@pytest.mark.parametrize("start", [init.odometry, init.spanning_tree, init.chordal])
def test_perfect_measurements_give_the_truth_from_nothing(ring, group, start):
    graph, truth = ring(group, n=40, noise=0.0)
    blank = np.tile(np.asarray(truth[:1]), (40, 1))
    poses = start(replace(graph, poses=blank))
    assert distance(group, np_to_jax(poses), truth) < 1e-9


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_chordal_lands_near_the_truth_where_odometry_does_not(ring, group):
    graph, truth = ring(group, n=60, loops=12, noise=0.03)
    assert distance(group, np_to_jax(init.chordal(graph)), truth) < 0.7 * distance(group, graph.poses, truth)


def test_odometry_bridges_gaps_and_walks_edges_backwards(ring):
    graph, truth = ring(n=12, loops=0, noise=0.0)
    lie = graph.lie
    i, j, measured = np.array(graph.i), np.array(graph.j), np.array(graph.measured)
    i[4], j[4] = j[4], i[4]
    measured[4] = lie.inverse(graph.measured[4])
    keep = np.arange(11) != 7
    extra = lie.compose(lie.inverse(truth[2]), truth[8])
    cut = replace(
        graph,
        i=np.append(i[keep], 2),
        j=np.append(j[keep], 8),
        measured=np.concatenate([measured[keep], np.asarray(extra)[None]]),
        information=np.asarray(graph.information),
        robust=np.ones(11, bool),
    )
    assert distance("se2", np_to_jax(init.odometry(cut)), truth) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("start", [init.odometry, init.spanning_tree, init.chordal])
@pytest.mark.parametrize(("group", "priors"), [("se2", "position"), ("se3", "pose"), ("se3", "position")])
def test_landmarks_start_where_they_were_seen(mapped, group, priors, start):
    graph, truth = mapped(group, priors=priors, noise=0.0)
    blank = np.tile(graph.lie.identity, (len(graph.poses), 1))
    blank[0] = truth[0]
    poses = start(replace(graph, poses=blank))
    assert distance(group, np_to_jax(poses[:-1]), np_to_jax(truth)) < 1e-8
    np.testing.assert_array_equal(poses[-1], graph.lie.identity)


def np_to_jax(poses):
    import jax.numpy as jnp

    return jnp.asarray(poses)
