"""What of a run can be asked again, where it was recorded."""

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

Load = Callable[[int], tuple[np.ndarray, np.ndarray | None] | None]


@dataclasses.dataclass(frozen=True)
class Recording:
    """A run as it was recorded.

    Attributes:
      load: frame number -> (RGB uint8, depth in metres or None); None for a frame that cannot be read.
      timestamps: s, increasing.
      odom_from_base: x, y (m) and heading (rad) of every frame; None without wheels.
      odometry_at: (what is added to the images' stamps, s) -> odometry of every frame: the offset is then estimated.
      ignored: pixels of the image that are no world, such as the robot's own body.
      level_at: (what is added to the images' stamps, s) -> how the robot leans at every frame, by odometry, None where
        it does not say; used where the floor views agree.
      names: of the images; empty where they have none.
    """

    load: Load
    timestamps: Float[np.ndarray, " F"]
    odom_from_base: Float[np.ndarray, "F 3"] | None = None
    odometry_at: Callable[[float], Float[np.ndarray, "F 3"]] | None = None
    ignored: Bool[np.ndarray, "H W"] | None = None
    level_at: Callable[[float], Float[np.ndarray, "F 4 4"] | None] | None = None
    names: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Returns the number of frames."""
        return len(self.timestamps)
