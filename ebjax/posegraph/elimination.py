"""Block elimination in pure JAX for chains with few loops: runs under jit and vmap, on any device.

Paths of poses with at most two neighbours are cut into segments; every step eliminates one pose of each segment, all
segments at once, and the survivors form the next, shorter level. What remains (the ends of the loops) is a dense core
for one Cholesky factorisation. The order is found once per graph on the host; a level is one `lax.scan` over index
arrays, so compilation does not grow with the graph. Sizes are padded to bounds that follow from the numbers of poses
and edges, so graphs that agree in these share a compiled program.
"""

from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float, Int

from ebjax.posegraph.assembly import Pattern, System, make_pattern
from ebjax.posegraph.graph import PoseGraph


class Level(NamedTuple):
    """Per step and segment: pose `p`, neighbours a, b (N = none), slots of pairs (p, a), (p, b), (a, b) (S = none)."""

    p: Int[Array | np.ndarray, "T n"]
    a: Int[Array | np.ndarray, "T n"]
    b: Int[Array | np.ndarray, "T n"]
    pa: Int[Array | np.ndarray, "T n"]
    pb: Int[Array | np.ndarray, "T n"]
    ab: Int[Array | np.ndarray, "T n"]


class Elimination(NamedTuple):
    """The levels, the core's poses (N = none), and the core's pair blocks with their row and column in the core."""

    levels: tuple[Level, ...]
    core: Int[Array | np.ndarray, " M"]
    core_slot: Int[Array | np.ndarray, " L"]
    core_row: Int[Array | np.ndarray, " L"]
    core_column: Int[Array | np.ndarray, " L"]


def _paths(left: list[int], neighbours: list[set[int]]) -> list[list[int]]:
    """Maximal runs of poses with at most two neighbours; of a closed ring one pose stays behind."""
    thin = {p for p in left if len(neighbours[p]) <= 2}
    paths, seen = [], set()

    def follow(here):
        path = []
        while here is not None:
            seen.add(here)
            path.append(here)
            here = next((q for q in neighbours[here] if q in thin and q not in seen), None)
        paths.append(path)

    for p in left:
        if p in thin and p not in seen and sum(q in thin for q in neighbours[p]) < 2:
            follow(p)
    for p in left:
        if p in thin and p not in seen:
            seen.add(p)
            follow(next(q for q in neighbours[p] if q not in seen))
    return paths


_SEGMENT = (8, 16)  # of the first level, of the others: its last pose stays


def order(
    neighbours: list[set[int]], *, small_core: int = 16
) -> tuple[list[list[list[int]]], list[int], list[tuple[int, int]]]:
    """Chooses the elimination: (segments per level, core, pairs that it fills in). Changes `neighbours`. Host code."""
    levels: list[list[list[int]]] = []
    fill = []
    left = list(range(len(neighbours)))
    while len(left) > small_core:
        segments = []
        for path in _paths(left, neighbours):
            pieces = -(-(len(path) + 1) // _SEGMENT[bool(levels)])
            cuts = np.linspace(-1, len(path), pieces + 1).round().astype(int)
            segments += [path[x + 1 : y] for x, y in pairwise(cuts)]
        segments = [s for s in segments if s]
        gone = {p for s in segments for p in s}
        if len(gone) < max(1, len(left) // 20):
            break
        for p in (p for s in segments for p in s):
            for q in neighbours[p]:
                neighbours[q].discard(p)
            if len(neighbours[p]) == 2:
                a, b = neighbours[p]
                if b not in neighbours[a]:
                    fill.append((a, b))
                    neighbours[a].add(b)
                    neighbours[b].add(a)
        levels.append(segments)
        left = [p for p in left if p not in gone]
    return levels, left, fill


def bounds(poses: int, loops: int, small_core: int) -> tuple[list[int], int]:
    """Segments per level and poses in the core that a chain with `loops` more edges does not exceed."""
    widths: list[int] = []
    left, cuts = poses, 2 * loops + 1
    while left > small_core:
        pieces = -(-left // _SEGMENT[bool(widths)])
        if pieces + cuts > 0.8 * left:
            break
        widths.append(pieces + cuts)
        left = pieces + cuts
    return widths, max(left, small_core)


def _room(need, bound):
    return bound if need <= bound <= 1.5 * need + 32 else need


def analyse(graph: PoseGraph) -> tuple[Pattern, Elimination]:
    """The symbolic factorisation: the pattern in elimination order and the index arrays of every level. Host code."""
    i, j, fixed = (np.asarray(x) for x in (graph.i, graph.j, graph.fixed))
    n = len(fixed)
    neighbours: list[set[int]] = [set() for _ in range(n)]
    live = ~(fixed[i] | fixed[j]) & (i != j)
    for a, b in zip(i[live].tolist(), j[live].tolist(), strict=True):
        neighbours[a].add(b)
        neighbours[b].add(a)
    widths, core_room = bounds(n, max(len(i) - n + 1, 0), 128 // graph.lie.dim)
    levels, core, fill = order(neighbours, small_core=core_room)
    rank = np.zeros(n, np.int64)
    rank[[p for segments in levels for s in segments for p in s] + core] = np.arange(n)
    pattern = make_pattern(graph, rank, [(a, b) if rank[a] < rank[b] else (b, a) for a, b in fill])
    none = len(pattern.first)
    pairs = zip(pattern.first.tolist(), pattern.second.tolist(), strict=True)
    slots = {(a, b): s for s, (a, b) in enumerate(pairs) if a != b}
    later: list[list[int]] = [[] for _ in range(n)]
    for a, b in slots:
        later[a].append(b)

    def row(p):
        a, b = (*sorted(later[p], key=rank.__getitem__), n, n)[:2]
        return p, a, b, slots.get((p, a), none), slots.get((p, b), none), slots.get((a, b), none)

    plan: list[Level] = []
    levels += [[] for _ in widths[len(levels) :]]
    widths += [0 for _ in levels[len(widths) :]]
    for segments, width in zip(levels, widths, strict=True):
        table = np.empty((6, _SEGMENT[bool(plan)] - 1, _room(len(segments), width)), np.int32)
        table[:3], table[3:] = n, none
        for k, s in enumerate(segments):
            table[:, : len(s), k] = np.array([row(p) for p in s]).T
        plan.append(Level(*table))
    place = {p: k for k, p in enumerate(core)}
    inner = [(s, place[a], place[b]) for (a, b), s in slots.items() if a in place and b in place]
    inner += [(none, 0, 0)] * (2 * core_room - len(inner))
    core += [n] * (_room(len(core), core_room) - len(core))
    slot, rows, columns = np.array(inner, np.int32).reshape(-1, 3).T
    return pattern, Elimination(tuple(plan), np.array(core, np.int32), slot, rows, columns)


def _inverse_factors(blocks):
    """L^-1 with L L^T = H for many small blocks; three by three written out, which is faster than a LAPACK loop."""
    if blocks.shape[-1] != 3:
        low = jnp.linalg.cholesky(blocks, symmetrize_input=False)
        eye = jnp.broadcast_to(jnp.eye(blocks.shape[-1], dtype=blocks.dtype), blocks.shape)
        return jax.lax.linalg.triangular_solve(low, eye, left_side=True, lower=True)
    p = 1 / jnp.sqrt(blocks[:, 0, 0])
    ba, ca = blocks[:, 1, 0] * p, blocks[:, 2, 0] * p
    q = 1 / jnp.sqrt(blocks[:, 1, 1] - ba * ba)
    cb = (blocks[:, 2, 1] - ca * ba) * q
    r = 1 / jnp.sqrt(blocks[:, 2, 2] - ca * ca - cb * cb)
    o = jnp.zeros_like(p)
    qp = -q * ba * p
    rows = [[p, o, o], [qp, q, o], [-r * (ca * p + cb * qp), -r * cb * q, r]]
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


_once = jax.lax.optimization_barrier  # fusion would repeat the factors in each of their readers


def _tmm(a, b):
    return jnp.matmul(a.swapaxes(-1, -2), b, precision="highest")


def _eliminate(carry, r):
    diagonal, off, g = carry
    d = g.shape[-1]
    low = _once(_inverse_factors(diagonal[r.p]))
    y = _once(jnp.matmul(low, jnp.concatenate([off[r.pa], off[r.pb], g[r.p][:, :, None]], -1), precision="highest"))
    ya, yb, yg = y[:, :, :d], y[:, :, d : 2 * d], y[:, :, 2 * d :]
    diagonal = diagonal.at[r.a].add(-_tmm(ya, ya)).at[r.b].add(-_tmm(yb, yb))
    off = off.at[r.ab].add(-_tmm(ya, yb))
    g = g.at[r.a].add(-_tmm(ya, yg)[:, :, 0]).at[r.b].add(-_tmm(yb, yg)[:, :, 0])
    return (diagonal, off, g), (low, y)


def _substitute(x, step):
    r, (low, y) = step
    d = x.shape[-1]
    rest = y[:, :, 2 * d] - jnp.sum(y[:, :, :d] * x[r.a][:, None, :], -1)
    rest = _once(rest - jnp.sum(y[:, :, d : 2 * d] * x[r.b][:, None, :], -1))
    return x.at[r.p].set(jnp.sum(low * rest[:, :, None], 1)), None


def solve(plan: Elimination, system: System, right: Float[Array, "N d"]) -> Float[Array, "N d"]:
    """H^-1 right by Schur complements level by level; NaN where H is not positive definite."""
    eye = jnp.eye(right.shape[-1], dtype=right.dtype)[None]
    carry = (
        jnp.concatenate([system.diagonal, eye]),
        jnp.concatenate([system.off, jnp.zeros_like(eye)]),
        jnp.concatenate([right, jnp.zeros_like(right[:1])]),
    )
    kept = []
    for level in plan.levels:
        carry, factors = jax.lax.scan(_eliminate, carry, level)
        kept.append(factors)
    x = jnp.zeros_like(carry[2]).at[plan.core].set(_solve_core(plan, *carry))
    for level, factors in zip(reversed(plan.levels), reversed(kept), strict=True):
        x, _ = jax.lax.scan(_substitute, x, (level, factors), reverse=True)
    return x[:-1]


def _solve_core(plan, diagonal, off, g):
    m, d = plan.core.shape[0], g.shape[-1]
    if m == 0:
        return g[plan.core]
    dense = jnp.zeros((m, m, d, d), g.dtype)
    dense = dense.at[np.arange(m), np.arange(m)].set(diagonal[plan.core])
    dense = dense.at[plan.core_row, plan.core_column].add(off[plan.core_slot])
    dense = dense.at[plan.core_column, plan.core_row].add(off[plan.core_slot].swapaxes(-1, -2))
    matrix = dense.transpose(0, 2, 1, 3).reshape(m * d, m * d)
    factor = jnp.linalg.cholesky(matrix)
    return jax.scipy.linalg.cho_solve((factor, True), g[plan.core].reshape(-1)).reshape(m, d)
