"""RTAB-Map's depth: RVL and 16-bit PNG in millimetres, float32 metres in the 4 bytes of a PNG's pixel.

The same column holds the right image of a stereo pair (8 bits, 1 or 3 channels), which is never depth.
"""

import struct
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from ebjax.io.depth_images import NO_DEPTH
from ebjax.io.images import PNG_SIGNATURE, BrokenFrame, png_is_whole
from ebjax.io.logs import rvl

HEAD_BYTES = 33
RVL_SIGNATURE = b"DEPTHRVL"
GREY, RGBA = 0, 6


class DepthHead(NamedTuple):
    """What the first bytes of a depth image say: its coding, and its size in pixels."""

    kind: Literal["rvl", "millimetres", "float"]
    width: int
    height: int


def depth_head(head: bytes) -> DepthHead | None:
    """Reads the first 33 bytes of a depth column; None where it is no depth, as a stereo pair's right image."""
    if len(head) >= 16 and head.startswith(RVL_SIGNATURE):
        return DepthHead("rvl", *struct.unpack("<2I", head[8:16]))
    if len(head) >= 26 and head.startswith(PNG_SIGNATURE):
        width, height, bits, colour = struct.unpack(">2I2B", head[16:26])
        if (bits, colour) == (16, GREY):
            return DepthHead("millimetres", width, height)
        if (bits, colour) == (8, RGBA):
            return DepthHead("float", width, height)
    return None


def depth_from_bytes(name: str, content: bytes) -> Float[np.ndarray, "H W"]:
    """Decodes depth along the optical axis, float32 m; 0 = missing (0, 65535 mm, negative, NaN, infinite).

    Args:
      name: of the image, for messages.
      content: the column's bytes.

    Raises:
      BrokenFrame: no depth, or damaged; names the image.
    """
    head = depth_head(content[:HEAD_BYTES])
    if head is None:
        raise BrokenFrame(f"{name}: its depth is no depth image (RVL, 16-bit PNG or float PNG); leave this node out")
    if head.kind == "rvl":
        try:
            raw = rvl.decode(content[16:], head.width, head.height)
        except ValueError as error:
            raise BrokenFrame(f"{name}: {error}; copy the database again") from None
    else:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if png_is_whole(content) else None
        if image is None:
            raise BrokenFrame(f"{name}: truncated or damaged depth PNG; copy the database again")
        raw = image if head.kind == "millimetres" else np.ascontiguousarray(image).view("<f4")[..., 0]
    if head.kind == "float":
        return np.where(np.isfinite(raw) & (raw > 0), raw, np.float32(0))
    return np.where(raw != NO_DEPTH, raw.astype(np.float32) / np.float32(1000), np.float32(0))
