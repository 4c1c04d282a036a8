"""General sparse LDL^T on the host (qdldl, AMD ordering), for graphs whose loops are many.

Called from compiled code by `jax.pure_callback`; under vmap the batch is solved one by one. The ordering is made once
per sparsity pattern and kept; the numbers alone travel per step.
"""

import threading
from collections import OrderedDict
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ebjax.posegraph.assembly import Pattern, System, make_pattern
from ebjax.posegraph.graph import PoseGraph


class SparsePlan(NamedTuple):
    """Upper triangle of H by columns; `source` finds each number in the raveled diagonal blocks, then pair blocks."""

    key: Int[np.ndarray, ""]
    source: Int[np.ndarray, " Z"]
    indices: Int[np.ndarray, " Z"]
    indptr: Int[np.ndarray, " C"]


_SOLVERS: OrderedDict[int, Any] = OrderedDict()
_KEPT = 8
_LOCK = threading.Lock()


def analyse(graph: PoseGraph) -> tuple[Pattern, SparsePlan]:
    """The pattern with rows above columns, and the map from blocks to compressed columns. Host code."""
    n, d = len(graph.fixed), graph.lie.dim
    pattern = make_pattern(graph, np.arange(n))
    inner = np.arange(d)
    p = np.arange(n)
    shape = (n, d, d)
    row = np.broadcast_to(p[:, None, None] * d + inner[:, None], shape)
    column = np.broadcast_to(p[:, None, None] * d + inner, shape)
    shape = (len(pattern.first), d, d)
    row = np.concatenate(
        [row.ravel(), np.broadcast_to(pattern.first[:, None, None] * d + inner[:, None], shape).ravel()]
    )
    column = np.concatenate([column.ravel(), np.broadcast_to(pattern.second[:, None, None] * d + inner, shape).ravel()])
    source = np.flatnonzero(row <= column)
    source = source[np.lexsort((row[source], column[source]))]
    indptr = np.searchsorted(column[source], np.arange(n * d + 1))
    indices = row[source]
    key = np.array(hash((indices.tobytes(), indptr.tobytes())), np.int64)
    return pattern, SparsePlan(key, source.astype(np.int32), indices.astype(np.int32), indptr.astype(np.int32))


def _factor_and_solve(key, indices, indptr, values, right):
    import qdldl
    import scipy.sparse

    values, right = np.asarray(values, np.float64), np.asarray(right)
    size = right.size
    matrix = scipy.sparse.csc_matrix((values, np.asarray(indices), np.asarray(indptr)), shape=(size, size))
    if not np.isfinite(values).all():
        return np.full_like(right, np.nan)
    with _LOCK:
        solver = _SOLVERS.pop(int(key), None)
        try:
            if solver is None:
                solver = qdldl.Solver(matrix, upper=True)
            else:
                solver.update(matrix, upper=True)
        except (RuntimeError, ValueError):
            return np.full_like(right, np.nan)
        _SOLVERS[int(key)] = solver
        if len(_SOLVERS) > _KEPT:
            _SOLVERS.popitem(last=False)
        return solver.solve(np.asarray(right, np.float64).ravel()).reshape(right.shape).astype(right.dtype)


def solve(plan: SparsePlan, system: System, right: Float[Array, "N d"]) -> Float[Array, "N d"]:
    """H^-1 right; NaN where the factorisation breaks down."""
    values = jnp.concatenate([system.diagonal.ravel(), system.off.ravel()])[plan.source]
    shape = jax.ShapeDtypeStruct(right.shape, right.dtype)
    return jax.pure_callback(
        _factor_and_solve, shape, plan.key, plan.indices, plan.indptr, values, right, vmap_method="sequential"
    )
