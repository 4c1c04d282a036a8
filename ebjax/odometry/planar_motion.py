"""Matched pixels of two images as rays of a robot that moves on its floor, and what is known of their depth.

A motion of the camera is (bx, by, theta): a ray r of camera j points along R(theta) r in base_i, and the camera moved
by b = (bx, by, 0) there; that of the base is i_from_j = (x, y, theta). Host side, NumPy.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from ebjax.geometry.camera import Camera

FLOOR_RANGE_M = 6.0


@dataclass(frozen=True)
class Pairs:
    """Matched pixels of two images and what is known of their depth; made by `make_pairs`.

    Attributes:
      pixels_i: in image i, px.
      pixels_j: in image j, px.
      rays_i: of the pixels, in base_i, of length 1 along the optical axis.
      rays_j: likewise in base_j.
      rho_floor: inverse depth in j of a point of the floor, 1/m; NaN where either ray meets no floor in range.
      rho_i: measured inverse depth, 1/m; NaN where missing in either image.
      rho_j: likewise.
      sigma_px: how exactly a corner lies, in one image.
      image_from_ray: P, a direction in base to homogeneous pixels.
      camera_xy: the optical centre on the base, m.
      height_m: of the optical centre.
    """

    pixels_i: Float[np.ndarray, "N 2"]
    pixels_j: Float[np.ndarray, "N 2"]
    rays_i: Float[np.ndarray, "N 3"]
    rays_j: Float[np.ndarray, "N 3"]
    rho_floor: Float[np.ndarray, " N"]
    rho_i: Float[np.ndarray, " N"]
    rho_j: Float[np.ndarray, " N"]
    sigma_px: Float[np.ndarray, " N"]
    image_from_ray: Float[np.ndarray, "3 3"]
    camera_xy: Float[np.ndarray, "2"]
    height_m: float

    def __len__(self) -> int:
        """Returns the number of matches."""
        return len(self.pixels_i)

    @cached_property
    def has_depth(self) -> Bool[np.ndarray, " N"]:
        """Whether depth was measured in both images."""
        return ~np.isnan(self.rho_j)

    @cached_property
    def may_be_floor(self) -> Bool[np.ndarray, " N"]:
        """Whether both rays meet the floor in range, and no depth says what is there."""
        return ~np.isnan(self.rho_floor) & ~self.has_depth

    @cached_property
    def known(self) -> Float[np.ndarray, " N"]:
        """Inverse depth in j, measured or else that of the floor, 1/m; 0 where it meets none."""
        return np.where(self.has_depth, self.rho_j, np.nan_to_num(self.rho_floor, nan=0.0))

    def take(self, rows: np.ndarray) -> "Pairs":
        """Some of the matches."""
        arrays = {n: getattr(self, n)[rows] for n in self.__dataclass_fields__ if n not in _OF_THE_CAMERA}
        return replace(self, **arrays)

    def without_floor(self) -> "Pairs":
        """The same, no match a point of the floor."""
        return replace(self, rho_floor=np.full(len(self), np.nan))

    def single(self) -> "Pairs":
        """The same in float32."""
        arrays = {n: getattr(self, n).astype(np.float32) for n in self.__dataclass_fields__ if n not in _OF_THE_CAMERA}
        return replace(self, **arrays)


_OF_THE_CAMERA = ("image_from_ray", "camera_xy", "height_m")


def make_pairs(
    pixels_i: Float[np.ndarray, "N 2"],
    pixels_j: Float[np.ndarray, "N 2"],
    camera: Camera,
    sigma_px: Float[np.ndarray, " N"],
    depth_i: Float[np.ndarray, " N"] | None = None,
    depth_j: Float[np.ndarray, " N"] | None = None,
) -> Pairs:
    """Rays, floor and depth of matched pixels.

    Args:
      pixels_i: px.
      pixels_j: their partners, px.
      camera: the mount on the base, known.
      sigma_px: standard deviation of a corner's place in one image.
      depth_i: along the optical axis at each pixel, m; 0 where missing.
      depth_j: likewise.
    """
    k, pose = np.asarray(camera.intrinsics, np.float64), np.asarray(camera.base_from_camera, np.float64)
    base_from_pixel = pose[:3, :3] @ np.linalg.inv(k)

    def rays(pixels):
        return np.column_stack([pixels, np.ones(len(pixels))]) @ base_from_pixel.T

    def on_floor(rays):
        rho = -rays[:, 2] / pose[2, 3]
        distance = np.linalg.norm(rays[:, :2], axis=1) / np.where(rho > 0, rho, np.nan)
        return np.where(distance < FLOOR_RANGE_M, rho, np.nan)

    one, two = rays(pixels_i), rays(pixels_j)
    rho = np.full((2, len(one)), np.nan)
    if depth_i is not None and depth_j is not None:
        both = np.stack([depth_i, depth_j])
        rho = np.where((both > 0).all(0), 1 / np.where(both > 0, both, 1), np.nan)
    return Pairs(
        np.asarray(pixels_i, np.float64),
        np.asarray(pixels_j, np.float64),
        one,
        two,
        np.where(np.isnan(on_floor(one)), np.nan, on_floor(two)),
        rho[0],
        rho[1],
        np.asarray(sigma_px, np.float64),
        k @ pose[:3, :3].T,
        pose[:2, 3],
        float(pose[2, 3]),
    )


def lever(theta: float | Float[np.ndarray, "*h"], camera_xy: Float[np.ndarray, "2"]) -> Float[np.ndarray, "*h 2"]:
    """(R - I) c: how far a turn of the base alone moves the camera."""
    c, s, (x, y) = np.cos(theta) - 1, np.sin(theta), camera_xy
    return np.stack([c * x - s * y, s * x + c * y], -1)


def base_motion(motion: Float[np.ndarray, "*h 3"], camera_xy: Float[np.ndarray, "2"]) -> Float[np.ndarray, "*h 3"]:
    """(bx, by, theta) of the camera -> (x, y, theta) of the base: t = b - (R - I) c."""
    return np.concatenate([motion[..., :2] - lever(motion[..., 2], camera_xy), motion[..., 2:]], -1)


def camera_motion(i_from_j: Float[np.ndarray, "*h 3"], camera_xy: Float[np.ndarray, "2"]) -> Float[np.ndarray, "*h 3"]:
    """(x, y, theta) of the base -> (bx, by, theta) of the camera: b = t + (R - I) c."""
    return np.concatenate([i_from_j[..., :2] + lever(i_from_j[..., 2], camera_xy), i_from_j[..., 2:]], -1)
