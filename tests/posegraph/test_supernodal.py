import numpy as np
import pytest
import scipy.sparse

from ebjax.posegraph import supernodal


def lattice(sides, block, seed=0):
    """A positive definite matrix with a block per point of a lattice and per pair of neighbours: its lower triangle."""
    rng = np.random.default_rng(seed)
    links = scipy.sparse.csr_matrix((1, 1))
    for side in sides:
        path = scipy.sparse.diags([np.ones(side - 1)], [1], (side, side))
        eye = scipy.sparse.identity
        links = scipy.sparse.kron(links, eye(side)) + scipy.sparse.kron(eye(links.shape[0]), path)
    links = links.tocoo()
    names = rng.permutation(links.shape[0])
    edges = np.stack([names[links.row], names[links.col]], 1)
    factor = np.zeros((len(edges) * block, links.shape[0] * block))
    for k, pair in enumerate(edges):
        for p in pair:
            factor[k * block : (k + 1) * block, p * block : (p + 1) * block] = rng.normal(size=(block, block))
    matrix = factor.T @ factor + np.eye(factor.shape[1])
    lower = scipy.sparse.csc_matrix(np.tril(matrix))
    lower.sort_indices()
    return matrix, lower


@pytest.mark.parametrize(("sides", "block"), [((1,), 3), ((30,), 3), ((9, 9), 3), ((5, 5, 5), 6), ((4, 4, 3), 1)])
def test_solves_what_a_dense_factorisation_solves(sides, block):
    matrix, lower = lattice(sides, block)
    factor = supernodal.Factor(lower.indices, lower.indptr)
    right = np.random.default_rng(1).normal(size=len(matrix))
    for scale in (1.0, 3.0):  # one symbolic factor serves many matrices
        factor.factorise(scale * lower.data)
        np.testing.assert_allclose(factor.solve(right), np.linalg.solve(scale * matrix, right), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("run", [1, 10**6])
@pytest.mark.parametrize("calls", [0.0, 1e12])
def test_neither_joining_fronts_nor_the_way_they_are_added_changes_the_answer(monkeypatch, run, calls):
    monkeypatch.setattr(supernodal, "_RUN", run)
    monkeypatch.setattr(supernodal, "_CALLS", calls)
    matrix, lower = lattice((7, 8), 3)
    factor = supernodal.Factor(lower.indices, lower.indptr)
    factor.factorise(lower.data)
    right = np.arange(1.0, len(matrix) + 1)
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(matrix, right), rtol=1e-9)


def test_separate_pieces():
    one, other = lattice((4, 4), 3)[1], lattice((3, 3), 2)[1]
    both = scipy.sparse.block_diag([one, other, scipy.sparse.identity(3)]).tocsc()
    both.sort_indices()
    factor = supernodal.Factor(both.indices, both.indptr)
    factor.factorise(both.data)
    right = np.ones(both.shape[0])
    full = both + scipy.sparse.tril(both, -1).T
    np.testing.assert_allclose(full @ factor.solve(right), right, atol=1e-10)


def test_what_is_not_positive_definite_is_refused():
    _, lower = lattice((5, 5), 3)
    factor = supernodal.Factor(lower.indices, lower.indptr)
    with pytest.raises(ArithmeticError, match="positive definite"):
        factor.factorise(-lower.data)
    factor.factorise(lower.data)
    assert np.isfinite(factor.solve(np.ones(75))).all()
