"""Which part of the floor a run looks at: chosen from the camera's geometry, or given by four image points.

The view is metric either way: its pixels map to the floor in base by `floor_from_view`. With `from_camera` that is a
scale; with `from_quad` (the paper's way) four points say what the view shows, and the camera only says where it lies.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.ndimage import maximum_filter

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
from ebjax.geometry.pytree import pytree

MAX_GROUND_SAMPLE_M = 0.025
"""Farther floor, where one image pixel covers more than this along the view, adds blur and no detail."""
MAX_LENGTH_M = 2.0
MIN_LENGTH_M = 0.4
QUAD_PX = 200
STEEP_RAD = np.radians(65.0)
"""A camera that looks down more steeply sees the floor on all sides of its foot."""
ASKEW_RAD = np.radians(15.0)
IGNORED_MARGIN_PX = 2
LEAST_SEEN = 0.1


@pytree
class RunView:
    """The floor view of a run: view pixel -> ideal image pixel, -> floor in base (m), and what is seen."""

    image_from_view: Float[Array, "3 3"]
    floor_from_view: Float[Array, "3 3"]
    seen: Bool[Array, "h w"]

    @property
    def size(self) -> tuple[int, int]:
        """(height, width), px."""
        return self.seen.shape[0], self.seen.shape[1]

    @property
    def centre_m(self) -> Float[np.ndarray, "2"]:
        """The centre of the view on the floor in base, m."""
        height, width = self.size
        return self._on_floor(np.array([[(width - 1) / 2, (height - 1) / 2]]))[0]

    @property
    def extent_m(self) -> float:
        """The longer diagonal of the view on the floor, m: views farther apart have nothing in common."""
        height, width = self.size
        a, b, c, d = self._on_floor(np.array([[0.0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]]))
        return float(max(np.linalg.norm(a - c), np.linalg.norm(b - d)))

    def _on_floor(self, pixels: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 2"]:
        x, y, w = np.asarray(self.floor_from_view, np.float64) @ np.column_stack([pixels, np.ones(len(pixels))]).T
        return np.stack([x / w, y / w], 1)


def choose_floor(camera: Camera, metres_per_px: float) -> FloorView:
    """The square of floor that the camera sees well where it looks: from the nearest visible floor, at most 2 m long.

    Its sides are parallel to base's axes, whatever the direction in which the camera looks.

    Raises:
      ValueError: the camera sees too little floor.
    """
    pose = np.asarray(camera.base_from_camera, np.float64)
    side, beside, steep = _side(pose)
    s = np.arange(-6.0 if steep else 0.02, 12.0, 0.01)
    points = s[:, None] * side[None] + beside[None]
    u, v, depth = np.asarray(image_from_floor(camera), np.float64) @ np.column_stack([points, np.ones_like(s)]).T
    pixels = np.stack([u, v], 1) / np.where(depth > 0.05, depth, np.nan)[:, None]
    raw = np.asarray(raw_from_ideal(camera, pixels))
    inside = (depth > 0.05) & ((raw >= 0) & (raw <= [camera.width - 1, camera.height - 1])).all(1)
    along = np.gradient(np.where(inside[:, None], raw, np.nan), axis=0)
    sample = np.gradient(s) / np.linalg.norm(along, axis=1)
    good = inside & (sample <= MAX_GROUND_SAMPLE_M)
    if not good.any():
        raise ValueError(
            "the camera sees no floor closely enough where it looks; check T_base_camera, or the mount that was given "
            "(height, pitch, roll, yaw), and fx, fy"
        )
    first = int(np.argmax(good))
    last = first + int(np.argmin(np.append(good[first:], False))) - 1
    near = float(s[first])
    length = min(MAX_LENGTH_M, float(s[last]) - near)
    if length < MIN_LENGTH_M:
        raise ValueError(
            f"the camera sees only {length:.2f} m of floor closely enough, at least {MIN_LENGTH_M} m are needed; "
            "check T_base_camera, or the mount that was given (height, pitch), and fx, fy, or tilt the camera down"
        )
    if np.abs(side).max() == 1:
        across = np.abs(side[::-1]) * length / 2
        ends = np.stack([near * side + beside - across, (near + length) * side + beside + across])
    else:
        centre = (near + length / 2) * side + beside
        ends = np.stack([centre - length / 2, centre + length / 2])
    (x_min, y_min), (x_max, y_max) = ends.min(0).tolist(), ends.max(0).tolist()
    return FloorView(x_min, x_max, y_min, y_max, metres_per_px)


def _side(pose: Float[np.ndarray, "4 4"]) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], bool]:
    """Where a camera looks along the floor, a point of the line that is looked at, and whether it looks down steeply.

    Near one of base's axes that is the axis; ahead and back the line is base's x axis, else it starts at the camera's
    foot.
    """
    foot = pose[:2, 3]
    if -pose[2, 2] > np.sin(STEEP_RAD):
        return np.array([1.0, 0.0]), foot, True
    ahead = pose[:2, 2] / np.linalg.norm(pose[:2, 2])
    if np.abs(ahead).max() < np.cos(ASKEW_RAD):
        return ahead, foot, False
    side = np.where(np.abs(ahead) == np.abs(ahead).max(), np.sign(ahead), 0.0)
    return side, np.zeros(2) if side[0] else np.array([foot[0], 0.0]), False


def from_camera(camera: Camera, floor: FloorView) -> RunView:
    """The metric view of a rectangle of floor (m, in base)."""
    homography = image_from_view(camera, floor)
    seen = field_of_view(camera, homography, floor.size, 1.0)
    return RunView(homography, jnp.asarray(floor.floor_from_view, homography.dtype), seen)


def check_quad(camera: Camera, quad: Float[np.ndarray, "4 2"]) -> None:
    """Raises ValueError where four image points are no quad in the order that `from_quad` wants."""
    order = "give far left, far right, near right, near left, as x y each, px"
    if not np.isfinite(quad).all() or (quad < 0).any() or (quad > [camera.width - 1, camera.height - 1]).any():
        raise ValueError(f"--quad: a point lies outside the image of {camera.width} x {camera.height} px; {order}")
    edges = np.roll(quad, -1, axis=0) - quad
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    if (turns < 1.0).any():
        raise ValueError(f"--quad: the points do not go clockwise round a convex patch; {order}")
    if quad[:2, 1].mean() >= quad[2:, 1].mean():
        raise ValueError(f"--quad: the first two points lie below the last two in the image; {order}")


def from_quad(
    camera: Camera, quad: Float[np.ndarray, "4 2"], margin: float, size: tuple[int, int] = (QUAD_PX, QUAD_PX)
) -> RunView:
    """The view that four image points span (Early Bird, section III-A): far left, far right, near right, near left.

    Args:
      camera: says where the points lie on the floor.
      quad: (x, y) px in the image.
      margin: how far the view reaches beyond the quad, as a share of its sides, on every side.
      size: (height, width) of the view, px.

    Raises:
      ValueError: the points do not span a convex patch of floor in that order.
    """
    height, width = size
    check_quad(camera, quad)
    inner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    corners = (inner + margin) / (1 + 2 * margin) * np.array([width - 1, height - 1])
    homography = from_four_points(jnp.asarray(corners), ideal_from_raw(camera, quad))
    homography = orient(homography, corners.mean(0))
    seen = field_of_view(camera, homography, size, 1.0)
    return RunView(homography, _on_floor(camera, homography), seen)


def without(view: RunView, camera: Camera, ignored: Bool[np.ndarray, "H W"]) -> RunView:
    """The view with `seen` false where an image pixel within 2 px is ignored.

    Args:
      view: of the camera.
      camera: whose images have the mask's size.
      ignored: raw image pixels that show no floor.

    Raises:
      ValueError: less than 10 % of what the view sees would be left.
    """
    grown = maximum_filter(ignored, 2 * IGNORED_MARGIN_PX + 1, mode="constant")
    height, width = view.size
    # Corners and edges too: near the camera a view pixel can be coarser than the margin.
    x, y = np.meshgrid(np.arange(-0.5, width, 0.5), np.arange(-0.5, height, 0.5))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    there = np.nan_to_num(np.asarray(raw_from_ideal(camera, apply(view.image_from_view, pixels))), nan=-1.0)
    column, row = np.rint(there).clip(-1, max(grown.shape)).astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < grown.shape[0]) & (column < grown.shape[1])
    hit = np.zeros(len(pixels), bool)
    hit[inside] = grown[row[inside], column[inside]]
    free = ~maximum_filter(hit.reshape(2 * height + 1, 2 * width + 1), 3)[1::2, 1::2]
    left = np.asarray(view.seen) & free
    share = left.sum() / max(1, int(np.asarray(view.seen).sum()))
    if share < LEAST_SEEN:
        raise ValueError(
            f"the mask leaves {share:.1%} of the floor view, at least {LEAST_SEEN:.0%} is needed; "
            "correct the mask, or choose a part of the floor that it leaves free by --quad"
        )
    return dataclasses.replace(view, seen=jnp.asarray(left))


def remounted_view(view: RunView, mounted: Camera) -> RunView:
    """The same pixels of the image, where another mount of the camera puts them on the floor."""
    return dataclasses.replace(view, floor_from_view=_on_floor(mounted, view.image_from_view))


@jax.jit
def _on_floor(camera, image_from_view):
    floor_from_image = jnp.linalg.inv(jnp.asarray(image_from_floor(camera), image_from_view.dtype))
    return floor_from_image @ image_from_view
