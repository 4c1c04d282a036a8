"""The whole pipeline as one differentiable function of the camera, the vocabulary and a network's weights.

    floor view -> descriptors -> NetVLAD, as it is and turned by pi -> d_ij = 1 - cosine -> sigmoid((tau - d_ij) / T)
               -> dual-softmax matches -> Kabsch on metric floor points -> i_from_j
    odometry + i_from_j, its square-root information times that weight -> pose graph -> trajectory -> ATE

Exact derivatives throughout, of the pose graph by its implicit adjoint. What is discrete is settled before, in `Pairs`:
which views are compared, and which points of the image are described. Those points stay where they are in the raw
image when the camera is moved or its lens changes; where they lie on the floor follows from both.
"""

import dataclasses
import typing
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ebjax.features.measure import LoopMeasurement
from ebjax.features.soft_match import dual_softmax, soft_measure
from ebjax.geometry.camera import OUTSIDE_PX, Camera, FloorView, ideal_from_raw, image_from_view
from ebjax.geometry.homography import adjugate, apply
from ebjax.geometry.mount import Mounting, remounted
from ebjax.geometry.optics import Optics, with_optics
from ebjax.geometry.pytree import pytree
from ebjax.geometry.rigid import kabsch
from ebjax.places.vlad import centred, netvlad
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.linear import Structure
from ebjax.posegraph.lm import solve
from ebjax.slam.soft_look import Look
from ebjax.views.floor_view import floor_view, view_taps
from ebjax.views.run_view import RunView


@pytree
class Words:
    """NetVLAD's centres, soft assignment and its bias, and tau, the distance at which a loop is believed by half."""

    centres: Float[Array, "K D"]
    assignment: Float[Array, "D K"]
    bias: Float[Array, "K"]
    threshold: Float[Array, ""]


@pytree
class Parameters:
    """All that can be tuned: `backbone` are the weights of the look, None for rootSIFT; None keeps the optics."""

    mounting: Mounting
    words: Words
    backbone: Any = None
    optics: Optics | None = None


@pytree
class SoftRun:
    """A run's frames: grey images in [0, 1], times (s), odometry as a chain (m, rad), the camera as it is believed.

    `truth` are the true positions, m, in any frame.
    """

    images: Float[Array, "N H W 1"]
    times_s: Float[Array, "N"]
    chain: PoseGraph
    camera: Camera
    truth: Float[Array, "N 2"]


@pytree
class Points:
    """The raw image points that are described (px), which count, and which pixels of the floor view are seen."""

    keypoints: Float[Array, "K 2"]
    mask: Float[Array, "K"]
    seen: Float[Array, "h w"]


@pytree
class Pairs:
    """Views that are compared: i, an earlier j, whether they face each other; and the pose graph's structure."""

    i: Int[Array, "P"]
    j: Int[Array, "P"]
    opposing: Bool[Array, "P"]
    structure: Structure


@dataclasses.dataclass(frozen=True)
class Softness:
    """What is not tuned: the floor that is looked at, the look, and how hard its choices are."""

    floor: FloorView
    look: Look
    stride_m: float = 0.055
    """Between the points that are described, on the floor, m. Matches lock onto the grid: 0.08 measures loops of
    rendered runs to 4 cm, 0.055 to 1 cm."""
    points: int = 320
    """How many are described at most, those whose surroundings are seen best."""
    loop_temperature: float = 0.05
    """T of the loop weight."""
    match_temperature: float = 0.05
    """T of the dual softmax."""
    kernel: str = "cauchy"
    """Robust kernel of the loops."""
    width: float = 3.0
    """Of the kernel, in standard deviations of a loop as measured: matches on a grid err by two to three of them."""
    exact: bool = True
    """Whether derivatives follow the camera into what the points look like, or only to where they lie on the floor.
    The whole derivative is exact and useless to descend: on a rendered run it changes its sign within 0.05 degrees,
    around that of the geometry, which hardly changes."""
    max_steps: int = 100
    rtol: float = 1e-20


class Corrected(typing.NamedTuple):
    """The corrected poses world_from_base, and what each pair contributed."""

    poses: Float[Array, "N 3"]
    distance: Float[Array, "P"]
    weight: Float[Array, "P"]
    measured: LoopMeasurement


def tuned(parameters: Parameters, camera: Camera) -> Camera:
    """The camera as the parameters have it mounted, and behind the lens that they say."""
    camera = remounted(camera, parameters.mounting)
    return camera if parameters.optics is None else with_optics(camera, parameters.optics)


def describe(
    parameters: Parameters, run: SoftRun, points: Points, softness: Softness
) -> tuple[Float[Array, "N 2 K D"], Float[Array, "K 2"], Float[Array, "K"]]:
    """What the points look like and where they are.

    Returns:
      Descriptors of the points in every view, as it is ([:, 0]) and turned by pi; where on the floor they lie, m; and
      their mask, zero too where the lens as it is now shows no such point.
    """
    floor, dtype = softness.floor, run.images.dtype
    camera = tuned(parameters, run.camera)
    homography = image_from_view(camera, floor)
    ideal = ideal_from_raw(camera, points.keypoints)
    shown = ideal[:, :1] > OUTSIDE_PX
    where = apply(adjugate(homography), jnp.where(shown, ideal, points.keypoints))
    looked, at, through = (homography, where, camera)
    if not softness.exact:
        looked, at, through = jax.lax.stop_gradient((homography, where, camera))
    view = RunView(looked, jnp.asarray(floor.floor_from_view, homography.dtype), points.seen > 0)
    samples = view_taps(view, through, dtype)

    @jax.checkpoint
    def one(image):
        return softness.look(parameters.backbone, floor_view(image, samples), points.seen, at.astype(dtype))

    return jax.lax.map(one, run.images), apply(view.floor_from_view, where), points.mask * shown[:, 0]


def global_vectors(
    words: Words, descriptors: Float[Array, "N 2 K D"], mask: Float[Array, "K"]
) -> Float[Array, "N V 2"]:
    """NetVLAD of every view as it is ([..., 0]) and turned by pi ([..., 1]), without the mean over the run."""

    def one(both):
        sides = [netvlad(side, mask, words.centres, words.assignment, words.bias) for side in both]
        return jnp.stack(sides, -1)

    return centred(jax.lax.map(one, descriptors))


@partial(jax.jit, static_argnames="softness")
def correct(parameters: Parameters, run: SoftRun, points: Points, pairs: Pairs, softness: Softness) -> Corrected:
    """The corrected trajectory; differentiable in `parameters`, once, forward or backward."""
    descriptors, floor_points, mask = describe(parameters, run, points, softness)
    vectors = global_vectors(parameters.words, descriptors, mask)
    way = pairs.opposing.astype(jnp.int32)
    theirs = jnp.take_along_axis(vectors[pairs.j], way[:, None, None], 2)[..., 0]
    distance = 1 - jnp.sum(vectors[pairs.i, :, 0] * theirs, 1)
    weight = jax.nn.sigmoid((parameters.words.threshold - distance) / softness.loop_temperature)

    @jax.checkpoint
    def measure(pair):
        i, j, way = pair
        matches = dual_softmax(descriptors[i, 0], descriptors[j, way], mask, mask, softness.match_temperature)
        return soft_measure(floor_points, floor_points, matches)

    measured = jax.lax.map(measure, (pairs.i, pairs.j, way))
    chain = run.chain
    information = jnp.linalg.inv(measured.covariance) * (weight.astype(floor_points.dtype) ** 2)[:, None, None]
    graph = PoseGraph(
        chain.poses,
        jnp.concatenate([chain.i, pairs.i]),
        jnp.concatenate([chain.j, pairs.j]),
        jnp.concatenate([chain.measured, measured.i_from_j]),
        jnp.concatenate([chain.information, information]),
        jnp.concatenate([chain.robust, jnp.ones(len(pairs.i), bool)]),
        chain.fixed,
    )
    limits: dict[str, typing.Any] = {"rtol": softness.rtol, "max_steps": softness.max_steps}
    solution = solve(graph, kernel=softness.kernel, width=softness.width, structure=pairs.structure, **limits)
    return Corrected(solution.poses, distance, weight, measured)


def ate_rmse_m(poses: Float[Array, "N 3"], truth: Float[Array, "N 2"]) -> Float[Array, ""]:
    """ATE rmse of positions after SE(2) alignment by least squares (in closed form), m."""
    estimate = poses[:, :2]
    rotation, translation = kabsch(estimate, truth, jnp.ones(len(truth), truth.dtype))
    errors = truth - (estimate @ rotation.T + translation[None, :])
    return jnp.sqrt(jnp.mean(jnp.sum(errors**2, 1)))
