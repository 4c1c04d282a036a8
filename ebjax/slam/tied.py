"""Where the last stretch of path lies in a map that stands still: the closures between the two that are believed.

The map's keyframes keep their settled poses. Two closures of different views that agree with each other, by the steps
between their own ends and by the map between the others, say where the stretch lies; nothing is told by one alone.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from ebjax.geometry.planar import adjoint, between, compose, inverse, inverse_covariance, log
from ebjax.odometry.causal import LOST
from ebjax.posegraph.graph import make_graph
from ebjax.posegraph.lm import solve
from ebjax.posegraph.marginals import marginals
from ebjax.slam.believe import Belief, BeliefConfig, alone_reasons
from ebjax.slam.join import joined
from ebjax.slam.measured import Measured
from ebjax.slam.walked import Walked

KERNEL, STEPS = "cauchy", 20


@dataclasses.dataclass(frozen=True)
class Settled:
    """A map that stands still.

    Attributes:
      poses: x, y (m), heading (rad) of its keyframes; NaN where one is not in the map's frame.
      step_m: the usual way from one to the next, m.
      step: covariance of such a step, right tangent.
    """

    poses: Float[np.ndarray, "E 3"]
    step_m: float
    step: Float[np.ndarray, "3 3"]


@dataclasses.dataclass(frozen=True)
class Stretch:
    """The last keyframes of a path by its steps.

    Attributes:
      poses: x, y (m), heading (rad).
      steps: covariance of the steps between them, right tangent.
      travelled: the way to each since the path's start, m.
    """

    poses: Float[np.ndarray, "n 3"]
    steps: Float[np.ndarray, "m 3 3"]
    travelled: Float[np.ndarray, " n"]


def believed(closures: Measured, stretch: Stretch, settled: Settled, config: BeliefConfig) -> np.ndarray:
    """Why each closure is not believed, or KEPT; as the engine believes, see `slam.believe`.

    Args:
      closures: i: row of the stretch, j: row of the map.
      stretch: see there.
      settled: see there.
      config: see there.
    """
    rows, walked = _side_by_side(closures, stretch, settled)
    belief = Belief(config)
    belief.update(rows, walked)
    return belief.reasons


def measured_well(closures: Measured, config: BeliefConfig) -> Bool[np.ndarray, " K"]:
    """Which of them nothing speaks against but other closures."""
    nowhere = Walked(np.zeros((2, 3)), np.zeros((1, 3, 3)), np.array([0, 1]))
    ends = {"i": np.ones_like(closures.i), "j": np.zeros_like(closures.j)}
    return alone_reasons(dataclasses.replace(closures, **ends), nowhere, config) == ""


def _side_by_side(closures: Measured, stretch: Stretch, settled: Settled) -> tuple[Measured, Walked]:
    """The keyframes of the map that closures name as one piece of path, the stretch behind them as another."""
    named, j = np.unique(closures.j, return_inverse=True)
    poses = settled.poses[named]
    ways = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    # The map between two keyframes errs as if they had been walked to the one from the other straight ahead.
    known = np.maximum(ways / settled.step_m, 1.0)[:, None, None] * settled.step
    gap = [LOST[None]] * bool(len(named))
    walked = Walked(
        np.concatenate([poses, stretch.poses]),
        np.concatenate([known, *gap, stretch.steps]),
        np.repeat([0, 1], [len(named), len(stretch.poses)]),
        np.concatenate([np.zeros(len(named)), stretch.travelled]),
    )
    return dataclasses.replace(closures, i=closures.i + len(named), j=j), walked


def tied(
    closures: Measured, stretch: Stretch, settled: Settled
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "3 3"]]:
    """The stretch in the map by closures that are believed, and the covariance of its last pose, right tangent."""
    rows, walked = _side_by_side(closures, stretch, settled)
    start = joined(walked.poses, walked.piece, rows)[0][walked.piece == 1]
    count, ties = len(start), len(closures.i)
    there, covariance = seen_in_map(closures, settled)
    # The map is one more pose, at the origin: a closure says where the stretch is seen from there.
    graph = make_graph(
        np.concatenate([start, np.zeros((1, 3))]),
        np.concatenate([np.arange(count - 1), np.full(ties, count)]),
        np.concatenate([np.arange(1, count), closures.i]),
        np.concatenate([between(stretch.poses[:-1], stretch.poses[1:]), there]),
        np.linalg.inv(np.concatenate([stretch.steps, covariance])),
        robust=np.arange(count - 1 + ties) >= count - 1,
        fixed=np.arange(count + 1) == count,
    )
    graph = dataclasses.replace(graph, poses=np.asarray(solve(graph, kernel=KERNEL, max_steps=STEPS).poses))
    last = marginals(graph, np.array([count - 1]), kernel=KERNEL)
    return np.asarray(graph.poses)[:count].astype(float), np.asarray(last[0], float)


def seen_in_map(closures: Measured, settled: Settled) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3 3"]]:
    """Where each closure alone says that its later keyframe is, and the covariance of that in its right tangent."""
    there = compose(settled.poses[closures.j], inverse(closures.i_from_j))
    return there, inverse_covariance(closures.i_from_j, closures.covariance)


def moved_on(
    covariance: Float[np.ndarray, "3 3"], step: Float[np.ndarray, "3"], noise: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "3 3"]:
    """The covariance of a pose after a step, each in its right tangent."""
    ad = adjoint(inverse(step))
    return ad @ covariance @ ad.T + noise


def fits(
    there: Float[np.ndarray, "K 3"],
    covariance: Float[np.ndarray, "K 3 3"],
    pose: Float[np.ndarray, "3"],
    expected: Float[np.ndarray, "3 3"],
    limit: float,
) -> Bool[np.ndarray, " K"]:
    """Which of some measured poses may be one that is expected, by the squared distance of the two.

    Args:
      there: as measured.
      covariance: of each.
      pose: as expected.
      expected: its covariance.
      limit: of the squared distance.
    """
    off = log(between(np.broadcast_to(pose, there.shape), there))
    squared = np.einsum("ka,kab,kb->k", off, np.linalg.inv(covariance + expected), off)
    return squared <= limit
