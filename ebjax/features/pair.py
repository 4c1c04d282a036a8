"""Two images of one floor, from the images to the motion: the views they are compared in, and the comparison.

A `PlaneView` says which part of an image is looked at and in which coordinates matches must agree: raw pixels, the
floor that four points span (pixels of that square), or the floor in metres. Host-side; every array program inside is
jitted.
"""

import dataclasses
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features
from ebjax.features.refine import refine
from ebjax.features.verify import Verified, log10_false_alarms, verify
from ebjax.geometry.camera import (
    Camera,
    FloorView,
    field_of_view,
    ideal_from_raw,
    image_from_floor,
    image_from_view,
    raw_from_ideal,
)
from ebjax.geometry.homography import apply, from_four_points, orient
from ebjax.geometry.ransac import Model
from ebjax.geometry.warp import gather, grid_points, taps

MAX_SUPERSAMPLE = 8
KEEP = 1000
MAX_LOG10_FALSE_ALARMS = -12.0
"""Below 0 would do for independent matches; the lines of any two corridors reach -8, a common floor -25 and less."""


@dataclasses.dataclass(frozen=True)
class PlaneView:
    """What of an image is compared, and in which plane.

    Attributes:
      image_from_view: view pixel -> ideal image pixel, w > 0 in front of the camera.
      plane_from_view: view pixel -> plane coordinates, in which matches must agree.
      size: (height, width) of the view, px.
      side: length of the view (without a margin) in the plane's unit.
      metric: whether that unit is the metre, in base.
      camera: whose ideal pixels the image's are; None: the image is taken as a pinhole's.
    """

    image_from_view: Float[np.ndarray, "3 3"]
    plane_from_view: Float[np.ndarray, "3 3"]
    size: tuple[int, int]
    side: float
    metric: bool = False
    camera: Camera | None = None


def raw_view(width: int, height: int) -> PlaneView:
    """The image itself."""
    return PlaneView(np.eye(3), np.eye(3), (height, width), float(max(width, height)))


def checked_quad(values: tuple[float, ...], width: int, height: int) -> np.ndarray:
    """The quad as four points.

    Raises:
      ValueError: a point outside the image, three points on a line, or another order than asked for.
    """
    quad = np.array(values, np.float64).reshape(4, 2)
    for x, y in quad:
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise ValueError(f"quad: ({x:g}, {y:g}) lies outside the {width}x{height} image; give points inside it")
    edges = np.roll(quad, -1, 0) - quad
    following = np.roll(edges, -1, 0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    if (np.abs(turns) < 1e-4 * width * height).any():
        raise ValueError("quad: three of the points lie on a line; give the four corners of a patch of floor")
    if (turns < 0).any():
        raise ValueError("quad: not a convex patch in order; give far left, far right, near right, near left")
    return quad


def quad_view(quad: Float[np.ndarray, "4 2"], size: int, margin: float, camera: Camera | None = None) -> PlaneView:
    """The floor that four image points span (Early Bird, section III-A), as a square with a margin.

    The plane has the quad's corners at (0, 0), (size, 0), (size, size), (0, size); with a camera it is the floor, m.

    Args:
      quad: (x, y) px: far left, far right, near right, near left.
      size: side of the square without its margin, px.
      margin: how far the view reaches beyond the quad on every side, as a share of its side.
      camera: of the image, where it is known.
    """
    corners = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float64)
    quad = quad if camera is None else np.asarray(ideal_from_raw(camera, quad))
    image_from_square = np.asarray(orient(from_four_points(corners, quad), corners.mean(0)))
    side = round(size * (1 + 2 * margin))
    shift = (size - side + 1) / 2
    square_from_view = np.array([[1.0, 0.0, shift], [0.0, 1.0, shift], [0.0, 0.0, 1.0]])
    homography = image_from_square @ square_from_view
    if camera is None:
        return PlaneView(homography, square_from_view, (side, side), float(size))
    floor_from_image = np.linalg.inv(np.asarray(image_from_floor(camera), np.float64))
    on_floor = np.asarray(apply(floor_from_image, quad))
    length = float(np.mean(np.linalg.norm(np.roll(on_floor, -1, 0) - on_floor, axis=1)))
    return PlaneView(homography, floor_from_image @ homography, (side, side), length, True, camera)


def metric_view(camera: Camera, floor: FloorView) -> PlaneView:
    """A rectangle of floor, metres."""
    homography = np.asarray(image_from_view(camera, floor), np.float64)
    return PlaneView(homography, floor.floor_from_view, floor.size, float(floor.x_max - floor.x_min), True, camera)


def look(image: UInt8[np.ndarray, "H W 3"], view: PlaneView) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
    """The view, RGB in [0, 1], and which of its pixels the image sees.

    Every view pixel averages as many samples along each axis as image pixels it covers: near floor would alias.
    """
    if np.array_equal(view.image_from_view, np.eye(3)):
        return jnp.asarray(image.astype(np.float32) / np.float32(255)), jnp.asarray(np.ones(view.size, bool))
    camera = view.camera or Camera(np.eye(3), np.eye(4), image.shape[1], image.shape[0])
    seen = field_of_view(camera, view.image_from_view, view.size, 1.0)
    down, across = _image_pixels_per_view_pixel(view, np.asarray(seen))
    scale_shift = [[1 / n, (1 - n) / (2 * n)] for n in (across, down)]
    view_from_fine = np.array(
        [[scale_shift[0][0], 0, scale_shift[0][1]], [0, scale_shift[1][0], scale_shift[1][1]], [0, 0, 1]]
    )
    return _averaged(image, camera, view.image_from_view @ view_from_fine, view.size, (down, across)), seen


@partial(jax.jit, static_argnames=("size", "samples"))
def _averaged(
    image: UInt8[Array, "H W 3"],
    camera: Camera,
    image_from_fine: Float[Array, "3 3"],
    size: tuple[int, int],
    samples: tuple[int, int],
) -> Float[Array, "h w 3"]:
    """A view of some size, of whose pixels each is the mean of some samples down and across."""
    (height, width), (down, across) = size, samples
    points = grid_points(image_from_fine, (height * down, width * across))
    raw = raw_from_ideal(camera, points.reshape(-1, 2)).reshape(points.shape)
    fine = gather(image.astype(jnp.float32) / 255, taps(raw, camera.size))
    return fine.reshape(height, down, width, across, 3).mean((1, 3)).astype(jnp.float32)


def _image_pixels_per_view_pixel(view: PlaneView, seen: Bool[np.ndarray, "h w"]) -> tuple[int, int]:
    rows, columns = np.nonzero(seen)
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), 1000)).astype(int)
    at = np.stack([columns, rows], 1)[chosen].astype(np.float64)

    def factor(step: np.ndarray) -> int:
        moved = np.linalg.norm(
            np.asarray(apply(view.image_from_view, at + step / 2))
            - np.asarray(apply(view.image_from_view, at - step / 2)),
            axis=1,
        )
        return int(np.clip(math.ceil(np.quantile(moved, 0.9)), 1, MAX_SUPERSAMPLE)) if len(moved) else 1

    return factor(np.array([0.0, 1.0])), factor(np.array([1.0, 0.0]))


@dataclasses.dataclass(frozen=True)
class Comparison:
    """What two views have in common.

    Attributes:
      inliers: putative matches that agree on one motion.
      total: putative matches.
      believed: whether chance would hardly show so many inliers.
      matched: rows of the keypoints that match and which agree: guided matches where believed, else the putative ones.
      pixels: the keypoints of a and of b in the raw images, px.
      plane: likewise in the view's plane.
      a_from_b: the motion in the plane; identity where nothing was found.
    """

    inliers: int
    total: int
    believed: bool
    matched: Verified
    pixels: tuple[Float[Array, "K 2"], Float[Array, "K 2"]]
    plane: tuple[Float[Array, "K 2"], Float[Array, "K 2"]]
    a_from_b: Float[np.ndarray, "3 3"]


def extract(
    extractor: Extractor, image: UInt8[np.ndarray, "H W 3"], view: PlaneView, *, turned: bool = False
) -> Features:
    """The features of the view, or of the view turned by pi; keypoints in pixels of the view as it is."""
    run = _extracted if extractor.jitted else _extract
    return run(extractor, turned, *look(image, view))


def _extract(extractor: Extractor, turned: bool, view: Float[Array, "h w 3"], seen: Bool[Array, "h w"]) -> Features:
    return (extractor.turned if turned else extractor.extract)(view, seen)


_extracted = jax.jit(_extract, static_argnums=(0, 1))


def compare(
    a: Features,
    b: Features,
    view: PlaneView,
    *,
    model: Model,
    tolerance: float,
    seed: int = 0,
) -> Comparison:
    """Matches and verifies two views; where the result is believed, matches again around it.

    Args:
      a: features of the first view.
      b: features of the second, turned for a pair that faces each other.
      view: of both.
      model: of the motion in the plane.
      tolerance: largest residual of an inlier, as a share of the view's side.
      seed: of RANSAC.
    """
    located = [_located(f.keypoints, view.plane_from_view, view.image_from_view) for f in (a, b)]
    plane, pixels = zip(*located, strict=True)
    limit = tolerance * view.side
    found = verify(
        a,
        b,
        plane[0],
        plane[1],
        key=jax.random.key(seed),
        tolerance=limit,
        model=model,
        keep=min(KEEP, len(plane[0])),
    )
    found = jax.tree.map(np.asarray, found)
    inliers, total = int(found.count), int(found.total)
    agreeing, possible = (_distinct(found, rows, plane, limit) for rows in (found.inliers, found.matched))
    rare = log10_false_alarms(agreeing, possible, math.pi * tolerance**2, model) < MAX_LOG10_FALSE_ALARMS
    # Both cameras look at the same side of the floor: no mirror image.
    believed = rare and float(np.linalg.det(found.query_from_reference)) > 0
    if believed:
        found = refine(a, b, plane[0], plane[1], found.query_from_reference, tolerance=limit, model=model)
        found = jax.tree.map(np.asarray, found)
    return Comparison(inliers, total, believed, found, pixels, plane, found.query_from_reference)


@jax.jit
def _located(
    keypoints: Float[Array, "K 2"], plane_from_view: Float[Array, "3 3"], image_from_view: Float[Array, "3 3"]
) -> tuple[Float[Array, "K 2"], Float[Array, "K 2"]]:
    """Keypoints of a view in its plane, and in ideal pixels of the image."""
    keypoints = keypoints.astype(jnp.result_type(0.0))
    return apply(plane_from_view, keypoints), apply(image_from_view, keypoints)


def _distinct(found: Verified, rows: Bool[np.ndarray, " M"], plane: tuple[Array, Array], tolerance: float) -> int:
    """How many places the matches join: keypoints that nearly coincide agree on anything."""
    counts = []
    for points, index in zip(plane, (found.query, found.reference), strict=True):
        cells = np.floor(np.asarray(points)[index[rows]] / (2 * tolerance))
        counts.append(len(np.unique(cells, axis=0)))
    return min(counts)
