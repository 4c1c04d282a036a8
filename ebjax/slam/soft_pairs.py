"""What the differentiable path takes as given: the points it describes and the pairs it compares. Host code.

Retrieval is hard and has no derivative: its answer, for the parameters of the moment, is held until it is asked again.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import FloorView, field_of_view, image_from_view, raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.odometry.wheels import WheelErrors
from ebjax.places.descriptor_map import MIN_SUPPORT
from ebjax.places.retrieve import comparable, shortlist
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.posegraph.linear import analyse
from ebjax.slam.measured import Measured
from ebjax.slam.path import path_of_wheels
from ebjax.slam.soft import (
    Pairs,
    Parameters,
    Points,
    Softness,
    SoftRun,
    describe,
    global_vectors,
    tuned,
)
from ebjax.slam.soft_look import support

MARGIN_PX = 2.0
"""What counts as seen lies so far inside the image at least."""


def chain_of(odom_from_base: Float[np.ndarray, "N 3"], odometry: WheelErrors) -> PoseGraph:
    """Odometry from frame to frame as the pipeline takes it, without closures."""
    none, zero = np.zeros(0, int), np.zeros(0)
    nothing = Measured(none, none, none > 0, zero, none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)))
    return path_of_wheels(odom_from_base, odometry).graph(nothing, none > 0)


def grid(floor: FloorView, stride_m: float) -> Float[np.ndarray, "K 2"]:
    """Points (x, y) px of a view, `stride_m` apart, a quarter of a pixel off whole and half pixels.

    There bilinear reads have a kink, and no derivative.
    """
    step = stride_m / floor.metres_per_px
    axes = []
    for length in (floor.width, floor.height):
        count = max(1, int(length / step))
        axes.append((length - 1) / 2 + (np.arange(count) - (count - 1) / 2) * step + 0.25)
    return np.stack(np.meshgrid(*axes, indexing="xy"), -1).reshape(-1, 2)


@partial(jax.jit, static_argnames="softness")
def choose_points(parameters: Parameters, run: SoftRun, softness: Softness) -> Points:
    """Points of a grid on the floor, under the camera as it is now; those count whose surroundings are seen."""
    floor = softness.floor
    camera = tuned(parameters, run.camera)
    homography = image_from_view(camera, floor)
    seen = field_of_view(camera, homography, floor.size, MARGIN_PX).astype(run.images.dtype)
    where = jnp.asarray(grid(floor, softness.stride_m), homography.dtype)
    share = support(seen, where.astype(seen.dtype), floor.metres_per_px)
    share, best = jax.lax.top_k(share, min(softness.points, len(where)))
    keypoints = raw_from_ideal(camera, apply(homography, where[best]))
    return Points(keypoints, (share > MIN_SUPPORT).astype(seen.dtype), seen)


@partial(jax.jit, static_argnames=("softness", "gap_s", "gap_m", "candidates"))
def _rank(parameters, run, points, softness, gap_s, gap_m, candidates):
    descriptors, _, mask = describe(parameters, run, points, softness)
    vectors = global_vectors(parameters.words, descriptors, mask)
    step = jnp.linalg.norm(jnp.diff(run.chain.poses[:, :2], axis=0), axis=1)
    travelled = jnp.concatenate([jnp.zeros(1, step.dtype), jnp.cumsum(step)])
    allowed = comparable(run.times_s, travelled, gap_s, gap_m)
    rows = jnp.arange(len(vectors), dtype=jnp.int32)
    cosine, j = shortlist(vectors, rows, allowed, k=candidates)
    best, order = jax.lax.top_k(cosine.reshape(len(rows), -1), candidates)
    return best, jnp.take_along_axis(j.reshape(len(rows), -1), order, 1), order >= candidates


def choose_pairs(
    parameters: Parameters,
    run: SoftRun,
    points: Points,
    softness: Softness,
    *,
    gap_s: float,
    gap_m: float,
    candidates: int = 1,
) -> Pairs:
    """The nearest earlier views of every view by NetVLAD, in either direction, and the structure of their pose graph.

    How many there are follows from the times alone: a run keeps its shapes when it is asked again.

    Args:
      parameters: of the moment.
      run: see there.
      points: from `choose_points`.
      softness: see there.
      gap_s: a view is compared with views so much earlier at least, s.
      gap_m: and, in the same direction, so much path earlier, m.
      candidates: of each view.
    """
    best, j, opposing = map(np.asarray, _rank(parameters, run, points, softness, gap_s, gap_m, candidates))
    rows, columns = np.nonzero(np.isfinite(best))
    i, j, opposing = rows, j[rows, columns].astype(int), opposing[rows, columns]
    chain = run.chain
    both = make_graph(
        np.asarray(chain.poses),
        np.concatenate([np.asarray(chain.i), i]),
        np.concatenate([np.asarray(chain.j), j]),
        np.zeros((len(chain.i) + len(i), 3)),
        np.zeros((len(chain.i) + len(i), 3, 3)),
    )
    return Pairs(jnp.asarray(i), jnp.asarray(j), jnp.asarray(opposing), analyse(both))
