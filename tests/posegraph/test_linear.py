import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.posegraph import analyse, make_graph, sparse
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


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["chain", "ring", "tree", "pieces", "loops", "dense"])
@pytest.mark.parametrize("solver", ["elimination", "qdldl", "supernodal", "cholmod"])
def test_solves_what_a_dense_factorisation_solves(kind, solver):
    if solver == "cholmod":
        pytest.importorskip("cvxopt")
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


def chain(loops, seed=0, n=1000):
    a = np.random.default_rng(seed).integers(0, n - 40, loops)
    i, j = np.concatenate([np.arange(n - 1), a]), np.concatenate([np.arange(1, n), a + 30])
    return make_graph(np.zeros((n, 3)), i, j, np.zeros((len(i), 3)), np.broadcast_to(np.eye(3), (len(i), 3, 3)))


def test_auto_takes_what_is_fastest_on_the_device(monkeypatch):
    assert analyse(chain(10)).plan.factor == "qdldl"
    rng = np.random.default_rng(0)
    tangle = (rng.integers(0, 400, 1200), rng.integers(0, 400, 1200))
    dense = make_graph(np.zeros((400, 3)), *tangle, np.zeros((1200, 3)), np.broadcast_to(np.eye(3), (1200, 3, 3)))
    assert analyse(dense).plan.factor in ("supernodal", "cholmod")
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert type(analyse(chain(11)).plan).__name__ == "Elimination"
    assert type(analyse(chain(900)).plan).__name__ == "SparsePlan"


@pytest.mark.parametrize("solver", ["elimination", "qdldl"])
def test_other_loops_compile_nothing(solver):
    shapes = [jax.tree.map(np.shape, analyse(chain(12, seed), solver)) for seed in range(5)]
    assert all(shape == shapes[0] for shape in shapes)


@pytest.mark.parametrize("solver", ["qdldl", "supernodal", "cholmod"])
def test_right_sides_share_a_factor(solver, monkeypatch):
    if solver == "cholmod":
        pytest.importorskip("cvxopt")
    graph = chain(5, n=60)
    structure = analyse(graph, solver)
    made = []
    factor = sparse.FACTORS[solver]
    module, name = factor.split(":")
    original = getattr(importlib.import_module(module), name)
    counted = lambda self, values: made.append(1) or original.factorise(self, values)  # noqa: E731
    monkeypatch.setattr(sparse, "_load", lambda _: type("Counted", (original,), {"factorise": counted}))
    sparse._FACTORS.clear()
    blocks = gauss_newton_blocks(graph, jnp.asarray(graph.poses), "none", jnp.asarray(1.0))
    system, _ = assemble(graph, structure.pattern, blocks, ~jnp.asarray(structure.fixed))
    right = jnp.asarray(np.random.default_rng(0).normal(size=(7, 60, 3)))
    together = jax.jit(jax.vmap(linear_solve, (None, None, 0)))(structure, system, right)
    assert len(made) == 1
    for x, b in zip(together, right, strict=True):
        np.testing.assert_allclose(matvec(system, structure.pattern, x), b, atol=1e-9)
    sparse._FACTORS.clear()


def test_bad_edges_and_solvers_are_refused():
    graph = make_graph(np.zeros((2, 3)), np.array([0]), np.array([2]), np.zeros((1, 3)), np.eye(3)[None])
    with pytest.raises(ValueError, match="outside 0 to 1"):
        analyse(graph)
    with pytest.raises(ValueError, match="choose one of"):
        analyse(graph, "klu")
