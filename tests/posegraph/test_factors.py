import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph.factors import edge_costs, edge_residual, exact_blocks, gauss_newton_blocks
from ebjax.posegraph.robust import KERNELS, rho, weight

WIDTH = jnp.asarray(1.3)


def half_cost(graph, kernel, e):
    def cost(delta):
        lie = graph.lie
        a = lie.compose(graph.poses[jnp.asarray(graph.i)[e]], lie.exp(delta[0]))
        b = lie.compose(graph.poses[jnp.asarray(graph.j)[e]], lie.exp(delta[1]))
        r = edge_residual(graph.group, a, b, graph.measured[e])
        return rho(kernel, r @ graph.information[e] @ r, WIDTH) / 2

    return cost


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
@pytest.mark.parametrize("kernel", ["none", "cauchy"])
def test_exact_blocks_are_the_hessian(ring, group, kernel):
    graph, _ = ring(group, n=12, loops=2, false_loops=1)
    blocks = jax.jit(lambda: exact_blocks(graph, graph.poses, kernel, WIDTH)[0])()
    zero = jnp.zeros((2, graph.lie.dim))
    hessian = jax.jit(
        lambda e: (jax.hessian(half_cost(graph, kernel, e))(zero), jax.grad(half_cost(graph, kernel, e))(zero))
    )
    for e in (0, len(graph.i) - 1):
        h, g = hessian(e)
        for ours, theirs in ((blocks.ii, h[0, :, 0]), (blocks.ij, h[0, :, 1]), (blocks.jj, h[1, :, 1])):
            np.testing.assert_allclose(ours[e], theirs, atol=1e-11 * abs(theirs).max())
        np.testing.assert_allclose(jnp.stack([blocks.gi[e], blocks.gj[e]]), g, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_gauss_newton_blocks_are_those_of_the_residual(ring, group):
    graph, _ = ring(group, n=12, loops=2, false_loops=1)
    blocks_at = jax.jit(lambda bent: gauss_newton_blocks(graph, graph.poses, "cauchy", WIDTH, bent))
    blocks = blocks_at(False)
    e, lie = len(graph.i) - 1, graph.lie

    def residual(delta):
        a = lie.compose(graph.poses[graph.i[e]], lie.exp(delta[0]))
        b = lie.compose(graph.poses[graph.j[e]], lie.exp(delta[1]))
        return edge_residual(group, a, b, graph.measured[e])

    j, r = jax.jit(lambda d: (jax.jacfwd(residual)(d), residual(d)))(jnp.zeros((2, lie.dim)))
    omega = graph.information[e] * weight("cauchy", r @ graph.information[e] @ r, WIDTH)
    np.testing.assert_allclose(blocks.ij[e], j[:, 0].T @ omega @ j[:, 1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(blocks.ii[e], j[:, 0].T @ omega @ j[:, 0], rtol=1e-9, atol=1e-9)
    bent = blocks_at(True)
    assert np.linalg.eigvalsh(bent.jj).min() > -1e-9 * abs(bent.jj).max()


@pytest.mark.parametrize("kernel", sorted(KERNELS))
def test_kernels_are_quadratic_at_zero_and_their_weights_are_their_slopes(kernel):
    s = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-6, 1e4, 60)])
    slope = jax.jit(jax.vmap(jax.grad(lambda x: rho(kernel, x, WIDTH))))(s)
    np.testing.assert_allclose(weight(kernel, s, WIDTH), slope, rtol=1e-11)
    assert rho(kernel, jnp.zeros(1), WIDTH)[0] == 0
    assert slope[0] == 1
    assert (np.diff(slope) <= 1e-15).all()


def test_the_kernel_leaves_unmarked_edges_alone(ring):
    graph, _ = ring(n=12, loops=2, false_loops=1)
    plain = edge_costs(graph, graph.poses, "none", WIDTH)
    unmarked = type(graph)(**{**vars(graph), "robust": np.arange(len(graph.i)) == 0})
    cost = edge_costs(unmarked, graph.poses, "cauchy", WIDTH)
    np.testing.assert_array_equal(cost[1:], plain[1:])
    assert cost[0] <= plain[0]
