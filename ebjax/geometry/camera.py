"""A camera over a floor, and the metric rectangle of floor that it looks at.

Base: x forward, y left, z up, the floor is z = 0. Camera: x right, y down, z forward. Metres and radians.

Pixels are ideal or raw: ideal ones are those of a pinhole with the same K, which homographies map to the floor; raw
ones are where the image, which a lens bends, shows them. Everything but the image itself is in ideal pixels.
"""

import dataclasses
import typing
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.geometry.homography import Arrays, Scalar, denominator, safe_denominator
from ebjax.geometry.homography import apply as apply_homography
from ebjax.geometry.lens import PINHOLE, Lens, bend_parts, lens
from ebjax.geometry.lens_inverse import unbend
from ebjax.geometry.pytree import pytree

OUTSIDE_PX = -1e6
LEAST_COSINE = 0.05
"""Between a ray and the optical axis: a pinhole's image of what lies farther out, 87 degrees, is endless."""


@pytree
class Camera:
    """Intrinsics K (px), p_base = base_from_camera p_camera (m), the image size (px), and the lens before it."""

    intrinsics: Float[Arrays, "3 3"]
    base_from_camera: Float[Arrays, "4 4"]
    width: int = dataclasses.field(metadata=dict(static=True))
    height: int = dataclasses.field(metadata=dict(static=True))
    lens: Lens = PINHOLE

    @property
    def size(self) -> tuple[int, int]:
        """(height, width), px."""
        return self.height, self.width


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FloorView:
    """A rectangle of the floor in base, metres, seen from above: forward is up, left is left.

    View pixel (u, v) has its centre at x = x_max - (v + 0.5) metres_per_px, y = y_max - (u + 0.5) metres_per_px.
    """

    x_min: float | int = dataclasses.field(metadata=dict(static=True))
    x_max: float | int = dataclasses.field(metadata=dict(static=True))
    y_min: float | int = dataclasses.field(metadata=dict(static=True))
    y_max: float | int = dataclasses.field(metadata=dict(static=True))
    metres_per_px: float | int = dataclasses.field(metadata=dict(static=True))

    def __post_init__(self) -> None:
        if not (self.x_min < self.x_max and self.y_min < self.y_max and self.metres_per_px > 0):
            raise ValueError(f"{self}: needs x_min < x_max, y_min < y_max and metres_per_px > 0")

    @property
    def width(self) -> int:
        """Columns, px."""
        return max(1, round((self.y_max - self.y_min) / self.metres_per_px))

    @property
    def height(self) -> int:
        """Rows, px."""
        return max(1, round((self.x_max - self.x_min) / self.metres_per_px))

    @property
    def size(self) -> tuple[int, int]:
        """(height, width), px."""
        return self.height, self.width

    @property
    def floor_from_view(self) -> Float[np.ndarray, "3 3"]:
        """View pixel (u, v, 1) -> floor point (x, y, 1) in base, m."""
        m = self.metres_per_px
        return np.array([[0.0, -m, self.x_max - 0.5 * m], [-m, 0.0, self.y_max - 0.5 * m], [0.0, 0.0, 1.0]])


@partial(jax.jit, static_argnames=("width", "height"))
def camera_over_floor(
    fx: Scalar,
    fy: Scalar,
    cx: Scalar,
    cy: Scalar,
    width: int,
    height: int,
    height_m: Scalar,
    pitch_rad: Scalar,
    roll_rad: Scalar = 0.0,
    x_m: Scalar = 0.0,
) -> Camera:
    """A camera that looks forward and down at the floor; differentiable in height, pitch and roll.

    Args:
      fx: focal length along x, px.
      fy: focal length along y, px.
      cx: principal point, px.
      cy: principal point, px.
      width: image width, px.
      height: image height, px.
      height_m: of the optical centre above the floor.
      pitch_rad: downward tilt of the optical axis; 0 looks at the horizon.
      roll_rad: turn about the optical axis, clockwise seen from behind the camera.
      x_m: of the optical centre ahead of the base's origin.
    """
    scalars = (height_m, pitch_rad, roll_rad, x_m, fx, fy, cx, cy)
    dtype = jnp.result_type(*scalars, 0.0)
    height_m, pitch, roll, x_m, fx, fy, cx, cy = (jnp.asarray(v, dtype) for v in scalars)
    s, c, sr, cr = jnp.sin(pitch), jnp.cos(pitch), jnp.sin(roll), jnp.cos(roll)
    zero, one = jnp.zeros((), dtype), jnp.ones((), dtype)
    base_from_camera = jnp.stack(
        [
            jnp.stack([-s * sr, -s * cr, c, x_m]),
            jnp.stack([-cr, sr, zero, zero]),
            jnp.stack([-c * sr, -c * cr, -s, height_m]),
            jnp.stack([zero, zero, zero, one]),
        ]
    )
    intrinsics = jnp.stack([jnp.stack([fx, zero, cx]), jnp.stack([zero, fy, cy]), jnp.stack([zero, zero, one])])
    return Camera(intrinsics, base_from_camera, width, height)


@typing.runtime_checkable
class CameraValues(typing.Protocol):
    """What a file says of a camera: `io.camera_file.CameraFile`."""

    @property
    def intrinsics(self) -> Float[np.ndarray, "3 3"]:
        """K, px."""

    @property
    def base_from_camera(self) -> Float[np.ndarray, "4 4"]:
        """Its mount, m."""

    @property
    def width(self) -> int:
        """In pixels."""

    @property
    def height(self) -> int:
        """In pixels."""

    @property
    def distortion_model(self) -> str:
        """Of its lens."""

    @property
    def distortion(self) -> tuple[float, ...]:
        """Coefficients."""


def camera_from(file: CameraValues) -> Camera:
    """The camera that a file describes.

    Raises:
      ValueError: an unknown lens.
    """
    bent = lens(file.distortion_model, file.distortion)
    intrinsics, pose = jax.device_put((np.asarray(file.intrinsics), np.asarray(file.base_from_camera)))
    return Camera(intrinsics, pose, file.width, file.height, bent)


@jax.jit
def raw_from_ideal(camera: Camera, pixels: Float[Arrays, "N 2"]) -> Float[Array, "N 2"]:
    """Where the image shows ideal pixels; far outside it (-1e6) what the lens cannot show. Differentiable."""
    pixels = jnp.asarray(pixels)
    if camera.lens.model == "pinhole":
        return pixels
    k = jnp.asarray(camera.intrinsics, pixels.dtype)
    y = (pixels[:, 1] - k[1, 2]) / k[1, 1]
    x = (pixels[:, 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    x, y, inside = bend_parts(camera.lens, x, y, jnp.ones_like(x))
    x, y = k[0, 0] * x + k[0, 1] * y + k[0, 2], k[1, 1] * y + k[1, 2]
    return jnp.stack([jnp.where(inside, x, OUTSIDE_PX), jnp.where(inside, y, OUTSIDE_PX)], axis=-1)


@jax.jit
def raw_slopes(camera: Camera, pixels: Float[Arrays, "N 2"]) -> Float[Array, "N 2 2"]:
    """The derivative of `raw_from_ideal`: d(raw x, raw y) / d(x, y) of ideal pixels."""
    pixels = jnp.asarray(pixels)
    if camera.lens.model == "pinhole":
        return jnp.broadcast_to(jnp.eye(2, dtype=pixels.dtype), (len(pixels), 2, 2))
    ones = jnp.zeros_like(pixels)
    axes = ones.at[:, 0].set(1), ones.at[:, 1].set(1)
    columns = [jax.jvp(lambda p: raw_from_ideal(camera, p), (pixels,), (axis,))[1] for axis in axes]
    return jnp.stack(columns, axis=-1)


@jax.jit
def ideal_from_raw(camera: Camera, pixels: Float[Arrays, "N 2"]) -> Float[Array, "N 2"]:
    """Ideal pixels of what the image shows; far outside (-1e6) where no pinhole can. Differentiable, once."""
    pixels = jnp.asarray(pixels)
    if camera.lens.model == "pinhole":
        return pixels
    k = jnp.asarray(camera.intrinsics, pixels.dtype)
    rays, inside = unbend(camera.lens, (_with_depth_1(pixels) @ jnp.linalg.inv(k).T)[:, :2])
    ahead = inside & (rays[:, 2] > LEAST_COSINE)
    ideal = (rays @ k.T)[:, :2] / jnp.where(ahead, rays[:, 2], 1)[:, None]
    return jnp.where(ahead[:, None], ideal, OUTSIDE_PX)


@jax.jit
def rays_of(camera: Camera, pixels: Float[Arrays, "N 2"]) -> tuple[Float[Array, "N 3"], Bool[Array, " N"]]:
    """Rays of raw pixels in the camera's frame, of length 1 behind a lens and depth 1 behind none; which there are."""
    pixels = jnp.asarray(pixels)
    rays = _with_depth_1(pixels) @ jnp.linalg.inv(jnp.asarray(camera.intrinsics, pixels.dtype)).T
    return (rays, jnp.ones(len(pixels), bool)) if camera.lens.model == "pinhole" else unbend(camera.lens, rays[:, :2])


def _with_depth_1(pixels: Float[Array, "N 2"]) -> Float[Array, "N 3"]:
    return jnp.concatenate([pixels, jnp.ones_like(pixels[:, :1])], axis=1)


@jax.jit
def project(camera: Camera, points_base: Float[Arrays, "N 3"]) -> tuple[Float[Array, "N 2"], Float[Array, " N"]]:
    """Ideal pixels K R^T (p - t) / depth, and the depth along the optical axis, m: <= 0 is behind the camera."""
    k, pose = jnp.asarray(camera.intrinsics), jnp.asarray(camera.base_from_camera)
    points_camera = (jnp.asarray(points_base) - pose[None, :3, 3]) @ pose[:3, :3]
    depth = points_camera[:, 2]
    w = safe_denominator(depth, jnp.sum(jnp.abs(points_camera), axis=1))
    pixels = (points_camera @ k.T)[:, :2] / w[:, None]
    return pixels, depth


@jax.jit
def backproject(
    pixels: Float[Arrays, "N 2"], depth_m: Float[Arrays, " N"], intrinsics: Float[Arrays, "3 3"]
) -> Float[Array, "N 3"]:
    """Lifts pixels into the camera frame, X = depth K^-1 x (Early Bird, eq. 9-10).

    Args:
      pixels: ideal ones of the image, not of the floor view, px.
      depth_m: along the optical axis; <= 0 or not finite means missing.
      intrinsics: K, px.

    Returns:
      Points in the camera frame, m; rows without depth are zero.
    """
    p, k, depth = jnp.asarray(pixels), jnp.asarray(intrinsics), jnp.asarray(depth_m)
    depth = jnp.where(jnp.isfinite(depth) & (depth > 0), depth, jnp.zeros_like(depth))
    y = (p[:, 1] - k[1, 2]) / k[1, 1]
    x = (p[:, 0] - k[0, 2] - k[0, 1] * y) / k[0, 0]
    return jnp.stack([x * depth, y * depth, depth], axis=-1)


@jax.jit
def image_from_floor(camera: Camera) -> Float[Array, "3 3"]:
    """K [r1 r2 t] of camera_from_base: floor (x, y, 1) at z = 0 of base, m -> pixels, with w = depth in metres."""
    k, pose = jnp.asarray(camera.intrinsics), jnp.asarray(camera.base_from_camera)
    rotation = pose[:3, :3].T
    translation = -rotation @ pose[:3, 3]
    return k @ jnp.stack([rotation[:, 0], rotation[:, 1], translation], axis=1)


@jax.jit
def image_from_view(camera: Camera, view: FloorView) -> Float[Array, "3 3"]:
    """View pixels -> image pixels, with w = depth in metres; what `warp` needs to make the floor view."""
    image = image_from_floor(camera)
    return jnp.matmul(image, jnp.asarray(view.floor_from_view, image.dtype))


@partial(jax.jit, static_argnames="view_size")
def field_of_view(
    camera: Camera, image_from_view: Float[Arrays, "3 3"], view_size: tuple[int, int], margin_px: Scalar = 0.0
) -> Bool[Array, "h w"]:
    """View pixels that the image shows: in front of the camera (w > 0) and inside the image by a margin.

    Args:
      camera: says how large the image is, and how its lens bends it.
      image_from_view: to ideal pixels; w > 0 in front of the camera (`homography.orient` makes it so).
      view_size: (height, width), px.
      margin_px: distance from the outermost pixel centres.
    """
    h = jnp.asarray(image_from_view)
    rows, cols = jnp.meshgrid(*(jnp.arange(n, dtype=h.dtype) for n in view_size), indexing="ij")
    grid = jnp.stack([cols.reshape(-1), rows.reshape(-1)], axis=1)
    shown = in_image(camera, apply_homography(h, grid), margin_px)
    return jnp.logical_and(shown, denominator(h, grid) > 0).reshape(view_size)


def in_image(camera: Camera, pixels: Float[Array, "N 2"], margin_px: Scalar = 0.0) -> Bool[Array, " N"]:
    """Which ideal pixels lie inside the image, by a margin from its outermost pixel centres."""
    x, y = raw_from_ideal(camera, pixels).T
    inside = (x >= margin_px) & (x <= camera.width - 1 - margin_px)
    return jnp.logical_and(inside, (y >= margin_px) & (y <= camera.height - 1 - margin_px))
