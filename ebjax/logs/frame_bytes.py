"""Frames as bytes of image files: as they were stored where that can be had, else encoded."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ebjax.io.images import PNG_SIGNATURE
from ebjax.io.logs.log import Images

QUALITY = 95
DEPTH_SCALE = 1000.0
FARTHEST = 65534
"""File units; 65535 is what some sensors write where they see nothing."""


def colour_bytes(images: Images, index: int) -> tuple[bytes, str, UInt8[np.ndarray, "H W 3"]]:
    """An image as a file's content, its suffix, and its pixels.

    The stored JPEG or PNG is taken unchanged if it decodes to the very pixels that the log gives; else a JPEG is made.

    Raises:
      BrokenFrame: it cannot be decoded.
    """
    rgb = images.decode(index)
    content = _stored(images, index)
    suffix = ".jpg" if content[:2] == b"\xff\xd8" else ".png" if content[:8] == PNG_SIGNATURE else None
    if suffix is not None:
        bgr = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if bgr is not None and np.array_equal(bgr[:, :, ::-1], rgb):
            return content, suffix, rgb
    return _encoded(".jpg", rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY]), ".jpg", rgb


def depth_bytes(depth_m: Float[np.ndarray, "H W"]) -> tuple[bytes, float, int]:
    """Depth as a 16-bit PNG of millimetres, the most it was rounded by (mm), and how many pixels were too far."""
    exact = np.where(np.isfinite(depth_m), depth_m, 0).astype(np.float64) * DEPTH_SCALE
    units = np.rint(exact)
    far = units > FARTHEST
    units[far | (units < 0)] = 0
    rounding = np.abs(units - exact)[units > 0].max(initial=0)
    return _encoded(".png", units.astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 1]), float(rounding), int(far.sum())


def _stored(images: Images, index: int) -> bytes:
    if images.stored is not None:
        return images.stored(index) or b""
    return images.files[index].read_bytes() if images.files else b""


def _encoded(suffix: str, image: np.ndarray, options: list[int]) -> bytes:
    done, content = cv2.imencode(suffix, np.ascontiguousarray(image), options)
    assert done, suffix
    return content.tobytes()
