"""Sparse Cholesky by dense fronts, the arithmetic done by LAPACK: for graphs with much fill, on what SciPy brings.

The multifrontal method (Duff, Reid 1983; Liu 1992). Columns are eliminated in order of minimum degree; a supernode is a
set of them with nearly the same rows below. Each supernode gathers its entries of H and what its children pass on in
one dense front, factorises its own columns there, and passes the rest to its parent.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.linalg import blas, lapack
from scipy.sparse.linalg import SuperLU, splu

_CALLS = 2e5  # operations that take as long as the calls for one more front
_RUN = 10  # entries; shorter runs are added faster one by one


def minimum_degree(nodes: int, i: Int[np.ndarray, " E"], j: Int[np.ndarray, " E"]) -> SuperLU:
    """SuperLU's factor of a graph's Laplacian in minimum degree order: `perm_c` is the place of every node."""
    link = scipy.sparse.coo_matrix((np.ones(len(i)), (i, j)), (nodes, nodes))
    matrix = scipy.sparse.diags_array(2.0 * np.bincount(np.append(i, j), minlength=nodes) + 1) - link - link.T
    options = {"SymmetricMode": True}
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


class _Child(NamedTuple):
    """What a child passes on: where its rows lie in the parent's front, also as runs (begin, end, place of begin)."""

    front: int
    place: Int[np.ndarray, " m"]
    runs: list[tuple[int, int, int]]


class _Front(NamedTuple):
    """Own columns from `begin` to `end`, all rows; entries `source` of H go to `place` of the raveled front."""

    begin: int
    end: int
    rows: Int[np.ndarray, " M"]
    source: Int[np.ndarray, " Z"]
    place: Int[np.ndarray, " Z"]
    children: list[_Child]


class Factor:
    """The symbolic factor of one sparsity pattern, the lower triangle by columns."""

    def __init__(self, indices: Int[np.ndarray, " Z"], indptr: Int[np.ndarray, " C"]):
        self._order, self._fronts = _analyse(indices, indptr)
        self._parts: list[tuple] = []

    def factorise(self, values: Float[np.ndarray, " Z"]) -> None:
        """Makes the numeric factor.

        Raises:
          ArithmeticError: the matrix is not positive definite.
        """
        parts: list[tuple] = []
        passed: dict[int, np.ndarray] = {}
        for number, (begin, end, rows, source, place, children) in enumerate(self._fronts):
            own, size = end - begin, len(rows)
            flat = np.zeros(size * size)
            flat[place] = values[source]
            front = flat.reshape(size, size, order="F")
            for child in children:
                _gather(front, passed.pop(child.front), child)
            corner, failed = lapack.dpotrf(front[:own, :own], lower=1, clean=0)
            if failed:
                raise ArithmeticError("the matrix is not positive definite")
            below = None
            if size > own:
                below = blas.dtrsm(1.0, corner, front[own:, :own], side=1, lower=1, trans_a=1)
                passed[number] = blas.dsyrk(-1.0, below, beta=1.0, c=front[own:, own:], lower=1)
            parts.append((begin, end, rows[own:], corner, below))
        self._parts = parts

    def solve(self, right: Float[np.ndarray, " C"]) -> Float[np.ndarray, " C"]:
        """H^-1 right by the latest factor."""
        x = right[self._order]
        for begin, end, rows, corner, below in self._parts:
            x[begin:end] = blas.dtrsv(corner, x[begin:end], lower=1)
            if below is not None:
                x[rows] -= below @ x[begin:end]
        for begin, end, rows, corner, below in reversed(self._parts):
            y = x[begin:end] if below is None else x[begin:end] - x[rows] @ below
            x[begin:end] = blas.dtrsv(corner, y, lower=1, trans=1)
        out = np.empty_like(x)
        out[self._order] = x
        return out


def _gather(front, passed, child):
    """Adds the lower triangle of `passed` to `front`; the upper ones hold nothing that is read."""
    if len(child.runs) * _RUN > len(child.place):
        front[child.place[:, None], child.place] += passed
        return
    for k, (begin, end, at) in enumerate(child.runs):
        columns = slice(at, at + end - begin)
        for first, last, row in child.runs[k:]:
            front[row : row + last - first, columns] += passed[first:last, begin:end]


def _analyse(indices, indptr):
    """The columns in the order of elimination, and the fronts, children before parents."""
    start, size = _nodes(indices, indptr)
    nodes = len(start)
    node = np.repeat(np.arange(nodes), size)
    count = np.diff(indptr)[start]
    low, high = np.repeat(np.arange(nodes), count), node[indices[_ranges(indptr[start], count)]]
    place = minimum_degree(nodes, high, low).perm_c
    width = np.empty(nodes, int)
    width[place] = size
    below, children, members = _supernodes(place[low], place[high], width)

    order = _children_first([p for p in range(nodes) if members[p] and not len(below[p])], children)
    places = [p for top in order for p in members[top]]
    node_at = np.empty(nodes, int)
    node_at[place] = np.arange(nodes)
    sequence = node_at[places]
    ends = np.cumsum(size[sequence])
    begin_of = np.empty(nodes, int)
    begin_of[places] = ends - size[sequence]
    columns = _ranges(start[sequence], size[sequence])
    rank = np.empty(len(columns), int)
    rank[columns] = np.arange(len(columns))

    a, b = rank[indices], rank[np.repeat(np.arange(len(columns)), np.diff(indptr))]
    row, column = np.maximum(a, b), np.minimum(a, b)
    by_column = np.argsort(column, kind="stable")
    cuts = np.searchsorted(column[by_column], np.append(0, ends))
    fronts: list[_Front] = []
    number: dict[int, int] = {}
    done = 0
    for top in order:
        source = by_column[cuts[done] : cuts[done + len(members[top])]]
        begin, done = int(begin_of[members[top][0]]), done + len(members[top])
        end = int(ends[done - 1])
        rest = below[top][np.argsort(begin_of[below[top]])]
        rows = np.concatenate([np.arange(begin, end), _ranges(begin_of[rest], width[rest])])
        at = np.searchsorted(rows, row[source]) + (column[source] - begin) * len(rows)
        number[top] = len(fronts)
        passing = [_child(number[child], fronts[number[child]], rows) for child in children[top]]
        fronts.append(_Front(begin, end, rows, source, at, passing))
    return columns, fronts


def _child(number, front, rows):
    place = np.searchsorted(rows, front.rows[front.end - front.begin :])
    breaks = np.flatnonzero(np.diff(place) != 1) + 1
    begin, end = np.append(0, breaks), np.append(breaks, len(place))
    return _Child(number, place, list(zip(begin.tolist(), end.tolist(), place[begin].tolist(), strict=True)))


def _ranges(begin, length):
    """The numbers begin, begin + 1, ... of every range, one after the other."""
    if not len(begin):
        return np.zeros(0, int)
    ends = np.cumsum(length)
    return np.arange(ends[-1]) + np.repeat(begin - (ends - length), length)


def _nodes(indices, indptr):
    """First column and width of every run of columns that share their rows: the blocks of the matrix."""
    count = np.diff(indptr)
    joined = np.flatnonzero(count[:-1] == count[1:] + 1)
    same = [
        np.array_equal(indices[indptr[c] + 1 : indptr[c + 1]], indices[indptr[c + 1] : indptr[c + 2]]) for c in joined
    ]
    start = np.setdiff1d(np.arange(len(count)), joined[np.array(same, bool)] + 1)
    return start, np.diff(np.append(start, len(count)))


def _children_first(roots, children):
    """All supernodes, each after its children."""
    order: list[int] = []
    stack = [(root, False) for root in roots]
    while stack:
        top, ready = stack.pop()
        if ready:
            order.append(top)
        else:
            stack += [(top, True), *((child, False) for child in children[top])]
    return order


def _supernodes(one, other, width):
    """Per place as a supernode's last: places below, child supernodes, members; no members where it joined another.

    A child joins its parent where that adds fewer operations to the fronts than a front of its own costs.
    """
    nodes = len(width)
    low, high = np.minimum(one, other), np.maximum(one, other)
    by = np.argsort(low, kind="stable")
    cuts = np.searchsorted(low[by], np.arange(nodes + 1))
    below: list[np.ndarray] = []
    children: list[list[int]] = [[] for _ in range(nodes)]
    members = [[p] for p in range(nodes)]
    own, rows = width.tolist(), [0] * nodes
    for p in range(nodes):
        reached = np.unique(np.concatenate([high[by[cuts[p] : cuts[p + 1]]], *(below[c] for c in children[p])]))
        below.append(reached[reached > p])
        rows[p] = int(width[below[p]].sum())
        if len(below[p]):
            children[below[p][0]].append(p)
        candidates, children[p] = sorted(children[p], key=lambda c: rows[c]), []
        while candidates:
            c = candidates.pop()
            merged = own[c] + own[p]
            more = _operations(merged, rows[p]) - _operations(own[c], rows[c]) - _operations(own[p], rows[p])
            if more < _CALLS + 2 * rows[c] ** 2:
                members[p], members[c] = members[c] + members[p], []
                own[p] = merged
                candidates += children[c]
            else:
                children[p].append(c)
    return below, children, members


def _operations(own, rows):
    return own**3 / 3 + own**2 * rows + own * rows**2
