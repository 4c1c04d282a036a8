from dataclasses import replace

import jax
import numpy as np
import pytest

from ebjax.posegraph import add_priors, make_graph, solve
from ebjax.posegraph.gauge import gauge


def chain(group="se2", n=6, weak=()):
    """A path round a corner; the edges `weak` say nothing of the rotation."""
    dim, size = (3, 3) if group == "se2" else (6, 7)
    poses, measured = np.zeros((n, size)), np.zeros((n - 1, size))
    if group == "se3":
        poses[:, 0] = measured[:, 0] = 1
    place = slice(0, 2) if group == "se2" else slice(4, 7)
    along = np.array([[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0.5], [0, 1, 0]] * n)[
        : n - 1, : 3 if group == "se3" else 2
    ]
    poses[1:, place], measured[:, place] = np.cumsum(along, 0), along
    information = np.tile(100.0 * np.eye(dim), (n - 1, 1, 1))
    for e in weak:
        information[e, dim // 3 + 1 :] = 0
    return make_graph(poses, np.arange(n - 1), np.arange(1, n), measured, information)


def tied(graph, rows):
    count = len(rows)
    weight = np.tile(50.0 * np.eye(graph.lie.dim), (count, 1, 1))
    return add_priors(graph, np.array(rows), np.asarray(graph.poses)[rows], weight, position=np.ones(count, bool))


@pytest.mark.parametrize(
    ("group", "rows", "left"),
    [("se2", [3], 1), ("se2", [1, 5], 0), ("se3", [2], 3), ("se3", [1, 5], 1), ("se3", [0, 2, 5], 0)],
)
def test_positions_leave_so_many_motions_of_the_whole(group, rows, left):
    graph = tied(chain(group), rows)
    found = gauge(graph)
    held = 0 if found.held is None else int((found.held & ~np.asarray(graph.fixed)[:, None]).sum())
    assert held == left
    assert found.chosen.tolist() == ([0] if left else [])
    np.testing.assert_array_equal(found.fixed, graph.fixed)


def test_what_is_held_costs_nothing():
    graph = tied(chain("se3"), [2])
    shaken = replace(graph, poses=graph.poses.at[1:6, -2:].add(0.1))
    solution = solve(shaken, kernel="none")
    assert np.isfinite(solution.poses).all()
    assert float(solution.cost) < 1e-12


def test_a_prior_on_a_pose_leaves_nothing_and_none_leaves_all():
    graph = chain()
    assert gauge(graph).chosen.tolist() == [0]
    held = add_priors(graph, np.array([4]), np.asarray(graph.poses)[4:5], np.eye(3)[None])
    assert gauge(held).chosen.tolist() == []
    assert gauge(held).fixed.tolist() == [False] * 6 + [True]


def test_pieces_are_held_one_by_one():
    graph = chain(n=6)
    keep = np.arange(5) != 2
    parts = (np.asarray(x)[keep] for x in (graph.i, graph.j, graph.measured, graph.information))
    cut = tied(make_graph(graph.poses, *parts), [1])
    found = gauge(cut)
    assert found.chosen.tolist() == [0, 3]
    assert found.fixed.tolist() == [False] * 3 + [True] + [False] * 2 + [True]
    assert found.held.sum(1).tolist() == [1, 0, 0, 3, 0, 0, 0]


@pytest.mark.parametrize(
    ("group", "weak", "rows"), [("se2", [4], "105"), ("se2", [3], "104, 105"), ("se3", [4], "105")]
)
def test_what_the_edges_leave_open_is_named(group, weak, rows):
    graph = chain(group, weak=weak)
    with pytest.raises(
        ValueError, match=rf"the measurements do not determine {rows}; measure these in every direction"
    ):
        gauge(graph, np.arange(100, 106))
    with pytest.raises(ValueError, match="the measurements do not determine"):
        solve(graph)
    fixed = np.isin(np.arange(6), [int(r) - 100 for r in rows.split(", ")])
    assert gauge(replace(graph, fixed=fixed)).chosen.tolist() == [0]


def test_one_direction_alone_does_not_place_a_landmark():
    graph = chain()
    weight = np.zeros((1, 3, 3))
    weight[0, 0, 0] = 10
    seen = make_graph(
        np.concatenate([graph.poses, [[1.0, 2.0, 0.0]]]),
        np.append(graph.i, 0),
        np.append(graph.j, 6),
        np.concatenate([graph.measured, [[1.0, 2.0, 0.0]]]),
        np.concatenate([graph.information, weight]),
        position=np.arange(6) == 5,
        landmark=np.arange(7) == 6,
    )
    with pytest.raises(ValueError, match="do not determine 6;"):
        gauge(seen)
    other = replace(seen, information=np.concatenate([graph.information, 10 * np.eye(3)[None]]))
    assert gauge(other).held.sum(1).tolist() == [3, 0, 0, 0, 0, 0, 1]
    assert gauge(replace(seen, fixed=np.arange(7) == 6)).fixed.tolist() == [False] * 6 + [True]


def test_long_paths_of_weak_edges_are_determined():
    n = 3000
    graph = chain(n=n)
    information = np.array(graph.information)
    information[:, 2] = information[:, :, 2] = 0
    both = make_graph(
        graph.poses,
        np.tile(graph.i, 2),
        np.tile(graph.j, 2),
        np.tile(graph.measured, (2, 1)),
        np.concatenate([information, np.broadcast_to(np.diag([0, 0, 1.0]), (n - 1, 3, 3))]),
    )
    assert gauge(both).chosen.tolist() == [0]


def test_traced_landmarks_need_a_structure():
    graph = tied(chain(), [1, 4])
    with pytest.raises(ValueError, match="structure="):
        jax.jit(lambda poses: solve(replace(graph, poses=poses)).poses)(graph.poses)
