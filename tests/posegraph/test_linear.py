import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import analyse, make_graph
from ebjax.posegraph.assembly import assemble, matvec
from ebjax.posegraph.factors import gauss_newton_blocks
from ebjax.posegraph.linear import linear_solve


def edges(kind, n=150):
    rng = np.random.default_rng(1)
    if kind == "chain":
        return np.arange(n - 1), np.arange(1, n)
    if kind == "ring":
        return np.arange(n), (np.arange(n) + 1) % n
    if kind == "tree":
        return rng.integers(0, np.arange(1, n)), np.arange(1, n)
    if kind == "pieces":
        i = np.array([k for k in range(n - 1) if k % 40 != 39])
        return i, i + 1
    loops = 40 if kind == "dense" else 6
    a, b = rng.integers(0, n, (2, loops))
    keep = a != b
    i, j = np.concatenate([np.arange(n - 1), a[keep], [3, 3]]), np.concatenate([np.arange(1, n), b[keep], [4, 4]])
    swap = rng.random(len(i)) < 0.3
    return np.where(swap, j, i), np.where(swap, i, j)


@pytest.mark.parametrize("kind", ["chain", "ring", "tree", "pieces", "loops", "dense"])
@pytest.mark.parametrize("solver", ["elimination", "sparse"])
def test_solves_what_a_dense_factorisation_solves(kind, solver):
    i, j = edges(kind)
    n, rng = 150, np.random.default_rng(0)
    information = np.broadcast_to(np.diag([2.0, 3.0, 5.0]), (len(i), 3, 3))
    fixed = np.arange(n) == 70
    graph = make_graph(rng.normal(size=(n, 3)), i, j, rng.normal(size=(len(i), 3)), information, fixed=fixed)
    structure = analyse(graph, solver)
    poses, one = jnp.asarray(graph.poses), jnp.asarray(1.0)

    @jax.jit
    def build():
        blocks = gauss_newton_blocks(graph, poses, "none", one)
        system, _ = assemble(graph, structure.pattern, blocks, ~jnp.asarray(structure.fixed))
        columns = jax.vmap(lambda e: matvec(system, structure.pattern, e.reshape(n, 3)).ravel())(jnp.eye(3 * n))
        return system, columns

    system, dense = build()
    np.testing.assert_allclose(dense, dense.T, atol=1e-9)
    right = jnp.asarray(rng.normal(size=(n, 3)))
    x = jax.jit(linear_solve)(structure, system, right)
    np.testing.assert_allclose(x.ravel(), np.linalg.solve(dense, right.ravel()), rtol=1e-6, atol=1e-8)


def test_auto_takes_elimination_for_few_loops_and_the_sparse_factor_for_many():
    rng = np.random.default_rng(0)
    n = 1000

    def graph(loops):
        a = rng.integers(0, n - 10, loops)
        i, j = np.concatenate([np.arange(n - 1), a]), np.concatenate([np.arange(1, n), a + 5])
        return make_graph(np.zeros((n, 3)), i, j, np.zeros((len(i), 3)), np.broadcast_to(np.eye(3), (len(i), 3, 3)))

    assert type(analyse(graph(10)).plan).__name__ == "Elimination"
    assert type(analyse(graph(900)).plan).__name__ == "SparsePlan"


def test_bad_edges_and_solvers_are_refused():
    graph = make_graph(np.zeros((2, 3)), np.array([0]), np.array([2]), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(ValueError, match="outside 0 to 1"):
        analyse(graph)
    with pytest.raises(ValueError, match="choose one of"):
        analyse(graph, "klu")
