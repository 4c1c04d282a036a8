from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import solve
from ebjax.posegraph.falseloops import add_false_loops, error_m, false_loops, loops_of


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
@pytest.mark.parametrize("share", [0.2, 0.5])
def test_the_share_is_of_all_loops(ring, group, share):
    graph, truth = ring(group, loops=20)
    spoilt = add_false_loops(replace(graph, poses=truth), share, seed=0)
    loops = loops_of(spoilt)
    assert (loops.sum() - 20) / loops.sum() == pytest.approx(share, abs=0.02)
    np.testing.assert_array_equal(spoilt.measured[: len(graph.i)], graph.measured)
    assert np.asarray(spoilt.robust)[len(graph.i) :].all()


def test_the_same_seed_gives_the_same_loops(ring):
    graph, _ = ring()
    one, again, other = (add_false_loops(graph, 0.5, seed=seed).measured for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


def test_loops_of_a_group_agree_with_each_other(ring):
    graph, truth = ring(n=120, loops=10, noise=0.0)
    spoilt = add_false_loops(replace(graph, poses=truth), 0.5, seed=0, group=10)
    assert len(spoilt.i) == len(graph.i) + 10
    # Without the true loops and without the odometry between, least squares meets all of a group at once.
    new = slice(len(graph.i), None)
    i, j = np.asarray(spoilt.i)[new], np.asarray(spoilt.j)[new]
    np.testing.assert_array_equal(np.diff(i), 1)
    np.testing.assert_array_equal(np.diff(j), 1)
    lie = graph.lie
    claims = jnp.asarray(spoilt.measured)[new]
    a, b = claims[:-1], claims[1:]
    back = lie.compose(lie.inverse(truth[i[1:]]), truth[i[:-1]])
    on = lie.compose(lie.inverse(truth[j[:-1]]), truth[j[1:]])
    np.testing.assert_allclose(
        lie.log(lie.compose(lie.inverse(b), lie.compose(back, lie.compose(a, on)))), 0, atol=1e-9
    )


def test_graphs_without_loops_are_refused(ring):
    graph, _ = ring(loops=0)
    with pytest.raises(ValueError, match="loops"):
        add_false_loops(graph, 0.5, seed=0)


def test_error_ignores_a_rigid_motion(ring):
    graph, truth = ring()
    moved = graph.lie.compose(jnp.broadcast_to(jnp.array([3.0, -1, 2]), truth.shape), truth)
    assert error_m(moved, truth, "se2") < 1e-9
    assert error_m(solve(graph).poses, truth, "se2") > 1e-3


def test_table(tmp_path, ring):
    from ebjax.posegraph.g2o import format_g2o

    graph, _ = ring(n=60, loops=10)
    (tmp_path / "ring.g2o").write_text(format_g2o(graph))
    rows = list(false_loops([tmp_path / "ring.g2o"], shares=(0.5,), seeds=2, kernels=("none", "consensus")))
    assert [(row["false"], row["against"]) for row in rows] == [("50%", "clean L2"), ("50%", "clean Cauchy")]
    assert rows[0]["none, m"] > rows[0]["consensus, m"]
