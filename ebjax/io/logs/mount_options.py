"""Where the camera sits on the robot, as the user says it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.geometry.mount_numbers import mount_of, pose_of

MOUNT = (
    "measure and give --mount.height-m 0.4 (of the lens above the floor, m) and --mount.pitch-deg 30 (how far it looks "
    "down), and --mount.x-m (of the lens ahead of base_link, m) where it is not 0"
)


@dataclass(frozen=True)
class MountOptions:
    """Where the camera sits on the robot, where its calibration or log does not say, or says it wrong."""

    file: Path | None = None
    """A file that says it: of Duckietown, the homography from the image to the floor (with its intrinsics as --camera),
    or any calibration that knows its mount. The numbers below come before it."""
    height_m: float | None = None
    """Of the lens above the floor, m."""
    pitch_deg: float | None = None
    """How far the optical axis looks down, degrees."""
    roll_deg: float | None = None
    """Turn about the optical axis, clockwise seen from behind the camera, degrees."""
    yaw_deg: float | None = None
    """Turn of the camera to the left, degrees; 180 looks back."""
    x_m: float | None = None
    """Of the lens ahead of base_link, m."""
    y_m: float | None = None
    """Of the lens to the left of base_link, m."""

    def pose(self, known: Float[np.ndarray, "4 4"] | None) -> Float[np.ndarray, "4 4"] | None:
        """base_from_camera: what is known of it, with what is given here in its place; None where that is too little.

        Raises:
          ValueError: a height that is not above the floor.
        """
        given = [self.pitch_deg, self.roll_deg, self.yaw_deg, self.height_m, self.x_m, self.y_m]
        if all(value is None for value in given):
            return known
        if self.height_m is not None and not self.height_m > 0:
            raise ValueError(f"mount.height_m is {self.height_m}: give the height of the lens above the floor, m")
        if known is None and (self.height_m is None or self.pitch_deg is None):
            return None
        start = np.zeros(6) if known is None else mount_of(known)
        scales = np.array([np.pi / 180] * 3 + [1.0] * 3)
        return pose_of(np.array([s if v is None else v * k for s, v, k in zip(start, given, scales, strict=True)]))


NOTHING = MountOptions()
