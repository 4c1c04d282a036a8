"""A robot's log, whatever its kind: images in time order, and what else was recorded beside them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.images import same_shape
from ebjax.io.trajectory import Trajectory


@dataclass(frozen=True)
class Images:
    """Images of one kind in time order, decoded when asked for.

    Attributes:
      source: what they came from, for messages: a list, a topic and its file.
      names: of the single images, for messages and tables.
      timestamps: s, increasing.
      decode: index -> the image; raises BrokenFrame, naming it. Colour: RGB uint8 H x W x 3. Depth: float32 H x W, m
        along the optical axis, 0 = missing.
      files: of the single images, where each is an image file of its own.
      stored: index -> the JPEG or PNG as it is stored, None where it is not stored so; None where no image is.
      size: width and height of most of them, px; None where it is not known before one is decoded.
      turned: these images turned as their EXIF asks, of another size; None where none asks for that.
      notes: what the user should know of how they are read, a line each.
    """

    source: str
    names: tuple[str, ...]
    timestamps: Float[np.ndarray, " N"]
    decode: Callable[[int], np.ndarray]
    files: tuple[Path, ...] = ()
    stored: Callable[[int], bytes | None] | None = None
    size: tuple[int, int] | None = None
    turned: "Images | None" = None
    notes: tuple[str, ...] = ()

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """The sizes that they can be read at, the stored one first; none where it is not known."""
        return tuple(images.size for images in (self, self.turned) if images is not None and images.size is not None)

    def fitting(self, size: tuple[int, int]) -> "Images":
        """These images; turned as EXIF asks where only so they have the shape of a camera's (width, height)."""
        fits = [same_shape(own, size) for own in self.sizes]
        return self.turned if self.turned is not None and fits == [False, True] else self

    def __len__(self) -> int:
        """Returns how many there are."""
        return len(self.names)


@dataclass(frozen=True)
class Log:
    """What was recorded. Opening one decodes a few images at most, and memory does not grow with the images.

    Attributes:
      path: of the file or folder.
      kind: in words, as "ROS 1 bag".
      colour: the images of the camera that is used.
      depth: registered to that camera, maybe of another resolution; None without.
      camera: None where the log says nothing of it.
      odometry: poses of base_link in the odometry's frame; None without.
      truth: poses of base_link in the world; None without.
      notes: what the user should know of how it was read, a line each.
      contents: what the log holds in all, a line each: topics with types and counts, sessions, cameras.
      base_from_camera: where the log says the camera sits, if it says so but nothing else of the camera.
      missing: for each of "camera", "mount", "odometry", "depth" that the log lacks, how to give it, one sentence.
    """

    path: Path
    kind: str
    colour: Images
    depth: Images | None = None
    camera: Calibration | None = None
    odometry: Trajectory | None = None
    truth: Trajectory | None = None
    notes: tuple[str, ...] = ()
    contents: tuple[str, ...] = ()
    base_from_camera: Float[np.ndarray, "4 4"] | None = None
    missing: Mapping[str, str] = field(default_factory=dict)

    def fitting(self, size: tuple[int, int]) -> "Log":
        """The log with its images as a camera of (width, height) sees them; see `Images.fitting`."""
        return replace(self, colour=self.colour.fitting(size))

    @property
    def camera_source(self) -> str:
        """What the camera was read from, for messages."""
        return str(self.path) if self.camera is None else self.camera.source

    @property
    def depth_source(self) -> str:
        """What the depth images were read from, for messages."""
        return str(self.path) if self.depth is None else self.depth.source
