"""General sparse Cholesky on the host, for graphs whose loops are many.

Called from compiled code; under vmap the matrices are factorised one by one, and right sides
that share a matrix share its factor. The symbolic factor is made once per sparsity pattern and kept. The factorisations
themselves are `ebjax.posegraph.ldl`, `ebjax.posegraph.supernodal` and `ebjax.posegraph.cholmod`.
"""

import importlib
import threading
import typing
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ebjax.posegraph.assembly import Pattern, System, make_pattern
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.host import host_call
from ebjax.posegraph.supernodal import minimum_degree

FACTORS = {
    "qdldl": "ebjax.posegraph.ldl:Factor",
    "supernodal": "ebjax.posegraph.supernodal:Factor",
    "cholmod": "ebjax.posegraph.cholmod:Factor",
}


@typing.no_type_check  # equinox puts booleans in place of arrays
@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SparsePlan:
    """Lower triangle of H by columns; `source` finds each number in the raveled diagonal blocks, then pair blocks.

    Rows and sources beyond indptr[-1] only fill the room of the largest graph of this size.
    """

    key: Int[Array | np.ndarray, ""]
    source: Int[Array | np.ndarray, " Z"]
    indices: Int[Array | np.ndarray, " Z"]
    indptr: Int[Array | np.ndarray, " C"]
    factor: str = field(metadata=dict(static=True))


_FACTORS: OrderedDict[tuple[str, int], Any] = OrderedDict()
_KEPT = 8
_LOCK = threading.Lock()


def analyse(graph: PoseGraph, factor: str) -> tuple[Pattern, SparsePlan]:
    """The pattern and the map from blocks to compressed columns. Host code.

    Raises:
      ModuleNotFoundError: the factorisation's package is not installed; says how to get it.
    """
    _load(factor)
    n, d = len(graph.fixed), graph.lie.dim
    pattern = make_pattern(graph)
    inner, p = np.arange(d), np.arange(n)
    pairs = pattern.first != pattern.second

    def numbers(first, second):
        shape = (len(first), d, d)
        row = np.broadcast_to(first[:, None, None] * d + inner[:, None], shape)
        return row.ravel(), np.broadcast_to(second[:, None, None] * d + inner, shape).ravel()

    row, column = map(np.concatenate, zip(numbers(p, p), numbers(pattern.first, pattern.second), strict=True))
    kept = np.concatenate([(row >= column)[: n * d * d], np.repeat(pairs, d * d)])
    row, column = np.maximum(row, column), np.minimum(row, column)
    source = np.flatnonzero(kept)
    source = source[np.lexsort((row[source], column[source]))]
    indptr = np.searchsorted(column[source], np.arange(n * d + 1))
    indices = row[source]
    key = np.array(hash((indices.tobytes(), indptr.tobytes())), np.int64)
    room = np.zeros(n * d * (d + 1) // 2 + len(pairs) * d * d - len(source), np.int32)
    source, indices = (np.concatenate([x.astype(np.int32), room]) for x in (source, indices))
    return pattern, SparsePlan(key, source, indices, indptr.astype(np.int32), factor)


def _load(factor):
    module, attribute = FACTORS[factor].split(":")
    return getattr(importlib.import_module(module), attribute)


def fill(graph: PoseGraph) -> float:
    """Operations per number of the Cholesky factor: what decides if dense blocks are worth their overhead. Host code.

    Counted on the graph of poses under SuperLU's minimum degree ordering.
    """
    factor = minimum_degree(len(graph.fixed), np.asarray(graph.i), np.asarray(graph.j)).L
    columns = np.diff(factor.indptr).astype(float)
    return float(graph.lie.dim * np.sum(columns**2) / np.sum(columns))


def _factor_and_solve(factor, key, indices, indptr, values, right):
    """Batches of any of the arrays stand in front; an axis of length one is shared, and factorised once."""
    shape, dtype = np.broadcast_shapes(values.shape[:-1], right.shape[:-2]), right.dtype
    if key.size > 1:
        raise ValueError("a batch must share one structure: vmap over numbers, not over edges")
    indptr = indptr.reshape(-1, indptr.shape[-1])[0]
    indices = indices.reshape(-1, indices.shape[-1])[0][: indptr[-1]]
    values = values.reshape(-1, values.shape[-1])[:, : indptr[-1]].astype(np.float64)
    columns = right.reshape(-1, right.shape[-2] * right.shape[-1]).astype(np.float64)
    name = (factor, int(key.ravel()[0]))
    with _LOCK:
        solver = _FACTORS.pop(name, None) or _load(factor)(indices, indptr)
        _FACTORS[name] = solver
        if len(_FACTORS) > _KEPT:
            _FACTORS.popitem(last=False)
        groups = (
            [columns]
            if len(values) == 1
            else [c[None] for c in np.broadcast_to(columns, (len(values), *columns.shape[1:]))]
        )
        out = [_solve_group(solver, v, c) for v, c in zip(values, groups, strict=True)]
    return np.concatenate(out).reshape(*shape, *right.shape[-2:]).astype(dtype)


def _solve_group(solver, values, columns):
    if not np.isfinite(values).all():
        return np.full_like(columns, np.nan)
    try:
        solver.factorise(values)
    except ArithmeticError:
        return np.full_like(columns, np.nan)
    return np.stack([solver.solve(c) for c in columns])


def solve(plan: SparsePlan, system: System, right: Float[Array, "N d"]) -> Float[Array, "N d"]:
    """H^-1 right; NaN where H is not positive definite."""
    values = jnp.concatenate([system.diagonal.ravel(), system.off.ravel()])[plan.source]
    result = jax.ShapeDtypeStruct(right.shape, right.dtype)
    arrays = (plan.key, plan.indices, plan.indptr, values, right)
    return host_call(_factor_and_solve, (plan.factor,), result, *arrays)


def solve_now(
    plan: SparsePlan, system: System, right: Float[Array | np.ndarray, "*n R d"]
) -> Float[np.ndarray, "*n R d"]:
    """As `solve`, of concrete arrays and many right sides; rows beyond the plan's, which nothing joins, give zero."""
    right = np.asarray(right)
    d = right.shape[-1]
    rows = (len(plan.indptr) - 1) // d
    diagonal, off = np.asarray(system.diagonal)[:rows], np.asarray(system.off)
    values = np.concatenate([diagonal.ravel(), off.ravel()])[np.asarray(plan.source)[: plan.indptr[-1]]]
    key, indices, indptr = (np.asarray(x) for x in (plan.key, plan.indices, plan.indptr))
    out = np.zeros_like(right)
    out[..., :rows, :] = _factor_and_solve(plan.factor, key, indices, indptr, values[None], right[..., :rows, :])
    return out
