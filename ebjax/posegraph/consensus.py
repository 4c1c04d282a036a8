"""Which loops of a graph to believe before optimising it: host code, in front of `solve`.

"pcm": the largest set of loops that agree in pairs (`ebjax.posegraph.consistency`).

"consensus": loops that another one confirms beyond chance. True loops come in clusters, along a path driven twice, and
false ones do not agree with their neighbours. Two neighbouring loops and the odometry between them make a cycle of
distance D and covariance S; among loops drawn at random from the space of poses, of volume V, a cycle closes at least
as well with probability p = ball(D) sqrt(det S) / V. A loop is believed if K M p < 1 for one of its M neighbours, so
that less than one of K random loops is believed in all (a contrario, Desolneux et al. 2000). Loops that
nothing confirms are not lost: the solution found without them decides. Where the test has no power, no loop being
confirmed, all are on an equal footing, as in "gnc-tls"; where least squares on all loops passes the chi-square test,
none is doubted (`ebjax.posegraph.gnc`).
"""

from math import gamma, pi
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool

from ebjax.posegraph.consistency import Loops, all_cycles, cycles_with, largest_clique, make_loops
from ebjax.posegraph.graph import PoseGraph, definite, loops_of, steps_of
from ebjax.posegraph.init import odometry
from ebjax.posegraph.matrices import adjoints, to_matrices
from ebjax.posegraph.robust import CHI2_99

RULES = ("pcm", "consensus")
_NEIGHBOURS = 16


class Believed(NamedTuple):
    """`loop`: edges that close loops; `kept`: those believed."""

    loop: Bool[np.ndarray, " E"]
    kept: Bool[np.ndarray, " E"]


def believed(graph: PoseGraph, rule: str) -> Believed:
    """Applies a rule of `RULES` to the robust edges that do not join successive rows; the others are odometry.

    Raises:
      ValueError: the graph is traced.
    """
    if any(isinstance(x, jax.core.Tracer) for x in (graph.measured, graph.information, graph.robust)):
        raise ValueError(f"{rule} chooses loops on the host; call solve outside jit, vmap and grad, or use gnc-tls")
    loop = np.asarray(graph.robust) & loops_of(graph)
    kept = np.zeros_like(loop)
    if not loop.any():
        return Believed(loop, kept)
    loops = _loops(graph, loop)
    if rule == "pcm":
        limit = CHI2_99[graph.lie.dim]
        kept[loop] = largest_clique(np.asarray(all_cycles(loops)) <= limit, np.ones(int(loop.sum())))
        return Believed(loop, kept)
    kept[loop] = _confirmed(loops, graph.lie.dim)
    return Believed(loop, kept)


def _loops(graph: PoseGraph, loop) -> Loops:
    """The loops over the odometry path; a gap in the odometry is a step that says nothing."""
    poses = odometry(graph)[: graph.pose_count]
    i, j, measured = (np.asarray(x) for x in (graph.i, graph.j, graph.measured))
    extent = np.ptp(poses[:, -3:] if graph.group == "se3" else poses[:, :2], axis=0).max() + 1
    covariance = _covariance(np.asarray(graph.information, float), extent)
    steps = np.tile(np.eye(graph.lie.dim) * extent**2, (len(poses) - 1, 1, 1))
    chain = np.flatnonzero(~loop & steps_of(graph))
    back = chain[i[chain] > j[chain]]
    ad = adjoints(to_matrices(measured[back]))
    turned = covariance.copy()
    turned[back] = ad @ covariance[back] @ ad.swapaxes(1, 2)
    steps[np.minimum(i, j)[chain]] = turned[chain]
    return make_loops(poses, steps, i[loop], j[loop], measured[loop], covariance[loop])


def _covariance(information, extent):
    """Inverse; where an edge says nothing, the error may be as large as the graph."""
    if definite(information):
        return np.linalg.inv(information)
    values, vectors = np.linalg.eigh(information)
    return (vectors / np.maximum(values, extent**-2)[:, None, :]) @ vectors.swapaxes(1, 2)


def _confirmed(loops: Loops, dim: int) -> Bool[np.ndarray, " K"]:
    from scipy.spatial import cKDTree

    ends = np.stack([loops.i, loops.j], 1)
    count = len(ends)
    if count < 2:
        return np.zeros(count, bool)
    own = np.arange(count)[:, None]
    near = np.broadcast_to(own, (count, _NEIGHBOURS + 1)).copy()
    near[:, :count] = cKDTree(ends).query(ends, min(_NEIGHBOURS + 1, count), p=1)[1]
    distance, half = cycles_with(loops, near)
    distance = np.where(near == own, np.inf, distance)
    ball = pi ** (dim / 2) / gamma(dim / 2 + 1)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # a path without extent says nothing
        chance = ball * distance ** (dim / 2) * np.exp(half) / _volume(loops, dim)
    closes = distance <= CHI2_99[dim]
    return (closes & (chance * count * min(_NEIGHBOURS, count - 1) < 1)).any(1)


def _volume(loops, dim):
    """Of the poses that a loop drawn at random may claim; a flat world counts as a tenth as high as it is wide."""
    places = np.asarray(loops.poses)[:, -3:] if dim == 6 else np.asarray(loops.poses)[:, :2]
    extent = np.ptp(places, axis=0)
    return np.prod(np.maximum(extent, extent.max() / 10)) * (2 * pi if dim == 3 else 8 * pi**2)
