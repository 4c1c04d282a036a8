"""What nothing measures: where a graph lies in the world, and rows that its edges leave undetermined. Host code.

A piece of a graph that no fixed row and no prior ties to the world may lie anywhere; its first pose is fixed. Priors on
positions may leave less than that: two GPS fixes leave a turn about the line through them. Then only so many numbers of
the first pose's tangent are held. What still moves at no cost is not determined, and is refused by name.

Rows that edges of full information join move as one body, and so do landmarks seen from it: what remains are the
motions of bodies against each other. Those that cost nothing are what (N + small I)^-1 leaves of random vectors, N the
normal equations of the bodies with every measured direction of weight one, scaled to a diagonal of ones.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ebjax.posegraph.graph import PoseGraph, components, definite
from ebjax.posegraph.matrices import adjoints, to_matrices

_SMALL, _MOVES = 1e-12, 3e-5  # of N's diagonal; what is left of a unit vector where nothing resists
_NOTHING = 1e-13  # of the largest eigenvalue of an information matrix: a direction without information
_ZERO = 1e-9  # of a diagonal of ones
_NAMED = 5


class Gauge(NamedTuple):
    """What stays where it is: rows, those fixed in the graph included, and single numbers of tangents.

    `held` is None where whole rows are all; `chosen` are the rows of which something stays for want of measurements.
    """

    fixed: Bool[np.ndarray, " N"]
    held: Bool[np.ndarray, "N d"] | None
    chosen: Int[np.ndarray, " K"]


def anchored(
    fixed: Bool[Array | np.ndarray, " N"], i: Int[Array | np.ndarray, " E"], j: Int[Array | np.ndarray, " E"]
) -> Bool[np.ndarray, " N"]:
    """`fixed`, and the first row of every connected piece that has no fixed one.

    A graph in several pieces is thereby solved piece by piece, each where its first pose stands.
    """
    fixed = np.array(fixed)
    label = components(len(fixed), np.asarray(i), np.asarray(j))
    tied = np.zeros(len(fixed), bool)
    tied[label[fixed]] = True
    fixed[label[~tied[label]]] = True
    return fixed


def gauge(graph: PoseGraph, names: Int[np.ndarray, " M"] | None = None) -> Gauge:
    """Chooses what stays where it is, beside `fixed`, so that the edges determine the rest.

    Where every edge has full information, or is traced and taken to have it, this is `anchored`.

    Args:
      graph: with `i`, `j` and `fixed` concrete; with all concrete if it has landmarks or positions.
      names: what rows are called in errors, the ids of a file; row numbers where not given.

    Raises:
      ValueError: names the rows that the edges leave undetermined.
    """
    plain = graph.position is None and graph.landmark is None
    traced = any(isinstance(x, jax.core.Tracer) for x in (graph.poses, graph.information, graph.position))
    if plain and (traced or not len(graph.i) or definite(graph.information)):
        fixed = anchored(graph.fixed, graph.i, graph.j)
        return Gauge(fixed, None, np.flatnonzero(fixed & ~np.asarray(graph.fixed)))
    if traced:
        raise ValueError(
            "the poses of a graph with landmarks or positions are traced; call analyse(graph) outside jit and pass its "
            "result as structure="
        )
    bodies = _bodies(graph)
    fixed, held = np.array(graph.fixed), bodies.point[:, None] & (np.arange(graph.lie.dim) >= bodies.space)
    moves = _moves(bodies, fixed, held)
    chosen = []
    for first in np.unique(_pieces(graph, bodies)[_loose(moves)]).tolist():
        still = _independent(moves[first], bodies.space) & ~held[first]
        if still.any():
            chosen.append(first)
            held[first] |= still
            fixed[first] = held[first].all()
    loose = np.flatnonzero(_loose(_moves(bodies, fixed, held) if chosen else moves))
    if len(loose):
        names = np.arange(len(fixed)) if names is None else names
        more = f" and {len(loose) - _NAMED} more" if len(loose) > _NAMED else ""
        raise ValueError(
            f"the measurements do not determine {', '.join(str(names[p]) for p in loose[:_NAMED])}{more}; "
            "measure these in every direction, or FIX them"
        )
    return Gauge(fixed, held if (held & ~fixed[:, None]).any() else None, np.array(chosen, int))


class _Bodies(NamedTuple):
    """Of every row the first row of its `body`, and its tangent by that one's, `by_first`.

    Of every edge its residual by the tangents of the two bodies, and its information with every eigenvalue one or zero.
    `point` are the landmarks, `space` the numbers of a position.
    """

    body: Int[np.ndarray, " N"]
    by_first: Float[np.ndarray, "N d d"]
    ends: Int[np.ndarray, "E 2"]
    residual: Float[np.ndarray, "E 2 d d"]
    weight: Float[np.ndarray, "E d d"]
    point: Bool[np.ndarray, " N"]
    space: int


def _bodies(graph):
    n, d = len(graph.poses), graph.lie.dim
    space = d // 3 + 1
    i, j = (np.asarray(x) for x in (graph.i, graph.j))
    position = np.zeros(len(i), bool) if graph.position is None else np.asarray(graph.position)
    point = np.zeros(n, bool) if graph.landmark is None else np.asarray(graph.landmark)
    information = np.array(graph.information, float)
    information[position, space:], information[position, :, space:] = 0, 0
    values, vectors = np.linalg.eigh(information)
    kept = values > _NOTHING * np.maximum(values[:, -1:], np.finfo(float).tiny)
    weight = (vectors * kept[:, None, :]) @ vectors.swapaxes(1, 2)
    world = to_matrices(np.asarray(graph.poses))
    relative = np.linalg.inv(world[i]) @ world[j]
    by_j = np.tile(np.eye(d), (len(i), 1, 1))
    by_j[position] = 0
    by_j[position, :space, :space] = relative[position, :-1, :-1]
    by_i = -by_j @ adjoints(np.linalg.inv(relative))

    def joined(body):
        by_first = adjoints(np.linalg.inv(world) @ world[body])
        by_first[point, space:] = 0
        residual = np.stack([by_i @ by_first[i], by_j @ by_first[j]], 1)
        return _Bodies(body, by_first, np.stack([body[i], body[j]], 1), residual, weight, point, space)

    bodies = joined(np.arange(n))
    while not np.array_equal(body := _merged(bodies), bodies.body):
        bodies = joined(body)
    return bodies


def _merged(bodies):
    """`body` after those are joined that all edges between them together hold in every direction."""
    n, alone = len(bodies.body), bodies.point & (bodies.body == np.arange(len(bodies.body)))
    apart = np.flatnonzero((bodies.ends[:, 0] != bodies.ends[:, 1]) & ~alone[bodies.ends].all(1))
    if not len(apart):
        return bodies.body
    # Of a pair the landmark is asked for its motion while the other stays, else the later row.
    ends = bodies.ends[apart]
    side = np.where(alone[ends].any(1), alone[ends[:, 1]], ends[:, 1] > ends[:, 0]).astype(int)
    moved, other = np.take_along_axis(ends, np.stack([side, 1 - side], 1), 1).T
    pairs, which = np.unique(np.stack([moved, other], 1), axis=0, return_inverse=True)
    by = bodies.residual[apart, side]
    held = np.zeros((len(pairs), *by.shape[1:]))
    np.add.at(held, which.ravel(), _between(by, bodies.weight[apart], by))
    size = np.sqrt(np.maximum(np.diagonal(held, axis1=1, axis2=2), np.finfo(float).tiny))
    rank = (np.linalg.eigvalsh(held / size[:, :, None] / size[:, None, :]) > _ZERO).sum(1)
    point = alone[pairs[:, 0]]
    rigid, seen = pairs[(rank == held.shape[1]) & ~point], pairs[(rank == bodies.space) & point]
    to = components(n, *rigid.T)
    to[seen[::-1, 0]] = to[seen[::-1, 1]]
    return to[bodies.body]


def _moves(bodies, fixed, held):
    """Of every row, what its body may do at no cost while `fixed` and `held` stay: random scaled tangents, or zero."""
    from scipy.sparse import csc_matrix, diags_array, eye_array
    from scipy.sparse.linalg import splu

    d = held.shape[1]
    first, place = np.unique(bodies.body, return_inverse=True)
    size = len(first) * d
    still = (held | fixed[:, None])[:, :, None] * np.eye(d)
    alone = np.flatnonzero(bodies.point & (bodies.body == np.arange(len(held))))
    turns = np.broadcast_to(np.diag(1.0 * (np.arange(d) >= bodies.space)), (len(alone), d, d))
    parts = [(place, place, _between(bodies.by_first, still, bodies.by_first)), (place[alone], place[alone], turns)]
    apart = bodies.ends[:, 0] != bodies.ends[:, 1]
    ends, weight = bodies.ends[apart], bodies.weight[apart]
    by_end = bodies.residual[apart].swapaxes(0, 1)
    for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
        parts.append((place[ends[:, a]], place[ends[:, b]], _between(by_end[a], weight, by_end[b])))
    row, column, block = (np.concatenate(x) for x in zip(*parts, strict=True))
    inner = np.arange(d)
    at = (row[:, None, None] * d + inner[:, None], column[:, None, None] * d + inner)
    rows, columns = (np.broadcast_to(x, block.shape).ravel() for x in at)
    normal = csc_matrix((block.ravel(), (rows, columns)), (size, size))
    diagonal = normal.diagonal()
    scale = diags_array(np.where(diagonal > _ZERO**2, diagonal, 1) ** -0.5)
    probes = np.random.default_rng(0).normal(size=(size, 2 * d))
    factor = splu((scale @ normal @ scale + _SMALL * eye_array(size)).tocsc())
    return factor.solve(_SMALL * probes).reshape(len(first), d, 2 * d)[place]


def _between(left, weight, right):
    return left.swapaxes(1, 2) @ weight @ right


def _loose(moves):
    return np.abs(moves).max((1, 2), initial=0) > _MOVES


def _pieces(graph, bodies):
    """Of every row, the first row that edges join it with, other than through the world."""
    n, i, j = len(bodies.body), np.asarray(graph.i), np.asarray(graph.j)
    tied = bodies.weight.any((1, 2)) & (np.maximum(i, j) < n - graph.world)
    return components(n, i[tied], j[tied])


def _independent(moves, space):
    """Numbers of a tangent, as many as it has independent motions; those of the rotation first."""
    left, chosen = moves.copy(), np.zeros(len(moves), bool)
    left[space:] *= 10
    enough = max(0.01 * np.linalg.norm(left, axis=1).max(), _MOVES)
    while np.linalg.norm(left, axis=1).max() > enough:
        k = int(np.argmax(np.linalg.norm(left, axis=1)))
        unit = left[k] / np.linalg.norm(left[k])
        left = left - np.outer(left @ unit, unit)
        left[k], chosen[k] = 0, True
    return chosen
