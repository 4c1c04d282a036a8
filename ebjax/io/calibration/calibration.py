"""What a calibration file says of a camera, whatever its kind."""

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

MOST = 1e9
LENGTHS = 0.05, 1000.0
"""Least and greatest focal length of a camera, in widths and heights of its image."""


@dataclass(frozen=True)
class Calibration:
    """A camera as a file, a topic or a database describes it. Pixel centres are at whole numbers, the first at (0, 0).

    Attributes:
      source: what the values came from, for messages: a file, or a topic and its file.
      kind: of file, in words.
      width: px.
      height: px.
      intrinsics: K, px, of the image as it is stored: raw where the lens bends, else rectified.
      distortion_model: a name in `geometry.lens_models`; pinhole where the stored image is rectified.
      distortion: the coefficients, in its order.
      base_from_camera: p_base = base_from_camera @ p_camera, m (camera x right, y down, z forward); None where the
        file says nothing of the mount.
      floor_from_image: homography from rectified pixels of K to the floor, m, where the file has that (Duckietown).
      depth_scale: depth file units per metre, where the file says.
      notes: what the user should know of how it was read, a line each.
    """

    source: str
    kind: str
    width: int
    height: int
    intrinsics: Float[np.ndarray, "3 3"]
    distortion_model: str = "pinhole"
    distortion: tuple[float, ...] = ()
    base_from_camera: Float[np.ndarray, "4 4"] | None = None
    floor_from_image: Float[np.ndarray, "3 3"] | None = None
    depth_scale: float | None = None
    notes: tuple[str, ...] = ()

    def scaled(self, width: int, height: int) -> "Calibration":
        """The camera of the same images at another size, x' = (x + 0.5) s - 0.5.

        Raises:
          ValueError: the sizes do not differ by one factor; names both.
        """
        if (width, height) == (self.width, self.height):
            return self
        across, down = width / self.width, height / self.height
        if abs(across - down) > 0.01 * across:
            raise ValueError(
                f"{self.source}: a camera of {self.width} x {self.height} px, but the images have {width} x {height}, "
                "another shape; give the calibration of this camera at this size"
            )
        scale = np.array([[across, 0.0, 0.5 * across - 0.5], [0.0, down, 0.5 * down - 0.5], [0.0, 0.0, 1.0]])
        note = f"{self.source}: {self.width} x {self.height} px, scaled to the images' {width} x {height}"
        return dataclasses.replace(
            self,
            width=width,
            height=height,
            intrinsics=scale @ self.intrinsics,
            floor_from_image=None if self.floor_from_image is None else self.floor_from_image @ np.linalg.inv(scale),
            notes=(*self.notes, note),
        )


def implausible(found: Calibration, cut: bool = False) -> str | None:
    """What no camera has: focal lengths that are not pixels, a principal point outside the image; None if all is well.

    Args:
      found: a calibration.
      cut: regions of the image may be cut out, so that the principal point may be anywhere.
    """
    k, (width, height) = found.intrinsics, (found.width, found.height)
    if not (np.abs(k) < MOST).all() or not all(abs(value) < MOST for value in found.distortion):
        return "numbers that are not finite, or larger than those of any camera; calibrate again"
    low, high = (np.array([width, height]) * factor for factor in LENGTHS)
    if (k.diagonal()[:2] < low).any() or (k.diagonal()[:2] > high).any():
        return (
            f"focal lengths {k[0, 0]:g} and {k[1, 1]:g} for {width} x {height} px; "
            "give them in pixels, not in millimetres or parts of the image"
        )
    if not cut and not (0 < k[0, 2] < width and 0 < k[1, 2] < height):
        return (
            f"the principal point ({k[0, 2]:g}, {k[1, 2]:g}) is outside the image of {width} x {height} px; "
            "give intrinsics and image size of the same resolution"
        )
    return None
