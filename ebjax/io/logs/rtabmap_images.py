"""The images of an RTAB-Map database, read and decoded one at a time."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ebjax.io.images import PNG_SIGNATURE, BrokenFrame, jpeg_is_whole, png_is_whole
from ebjax.io.logs.rtabmap_database import reading
from ebjax.io.logs.rtabmap_depth import depth_from_bytes


@dataclass(frozen=True)
class Strip:
    """One camera's part of images of several side by side. `shape` is its width and height, px; 0 where not known."""

    index: int
    count: int
    shape: tuple[int, int] = (0, 0)

    def cut(self, name: str, image: np.ndarray) -> np.ndarray:
        """Cuts the camera's part out of an image.

        Raises:
          BrokenFrame: the image is no row of so many equal ones.
        """
        height, width = image.shape[:2]
        wanted = self.count * self.shape[0] / self.shape[1] if all(self.shape) else width / height
        if width % self.count or abs(width / height - wanted) > 0.01 * wanted:
            raise BrokenFrame(
                f"{name}: {width} x {height} px, but its calibration has {self.count} camera(s) of "
                f"{self.shape[0]} x {self.shape[1]} px; leave this node out"
            )
        part = width // self.count
        return np.ascontiguousarray(image[:, self.index * part : (self.index + 1) * part])


def name_of(node: int) -> str:
    """The name of a node's image, "node 12"."""
    return f"node {node}"


def node_of(name: str) -> int:
    """The number of the node that an image's name names; the inverse of `name_of`.

    Raises:
      ValueError: it is no such name.
    """
    word, _, number = name.partition(" ")
    if word != "node" or not number.isdecimal():
        raise ValueError(f"{name!r} names no node of an RTAB-Map database; a name is 'node 12'")
    return int(number)


def _column(path: Path, column: str, node: int) -> bytes:
    name = f"{path}: {name_of(node)}"
    try:
        with reading(path) as database:
            row = database.execute(f"SELECT {column} FROM Data WHERE id = ?", (node,)).fetchone()
    except ValueError as error:
        raise BrokenFrame(f"{name}: {error}") from None
    if row is None or not isinstance(row[0], bytes) or not row[0]:
        raise BrokenFrame(f"{name}: has no {column}; leave it out")
    return row[0]


def stored_colour(path: Path, node: int) -> bytes:
    """A node's image as it is stored: a JPEG or PNG file's content.

    Raises:
      BrokenFrame: missing; names file and node.
    """
    return _column(path, "image", node)


def read_colour(path: Path, node: int, strip: Strip) -> UInt8[np.ndarray, "H W 3"]:
    """Reads a node's image as RGB, 0-255; grey images get three equal channels.

    Raises:
      BrokenFrame: missing, truncated or not an image; names file and node.
    """
    name, content = f"{path}: {name_of(node)}", _column(path, "image", node)
    if content[:2] == b"\xff\xd8" and not jpeg_is_whole(content):
        raise BrokenFrame(f"{name}: truncated JPEG; copy the database again")
    if content[:8] == PNG_SIGNATURE and not png_is_whole(content):
        raise BrokenFrame(f"{name}: truncated or damaged PNG; copy the database again")
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise BrokenFrame(f"{name}: not an image that OpenCV can decode; leave it out")
    return cv2.cvtColor(strip.cut(name, image), cv2.COLOR_BGR2RGB)  # type: ignore[return-value]


def read_depth(path: Path, node: int, strip: Strip) -> Float[np.ndarray, "H W"]:
    """Reads a node's depth along the optical axis, float32 m, 0 = missing.

    Raises:
      BrokenFrame: missing, damaged or no depth; names file and node.
    """
    name = f"{path}: {name_of(node)}"
    return strip.cut(name, depth_from_bytes(name, _column(path, "depth", node)))
