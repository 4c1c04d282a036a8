"""Images from files: decoded only if whole, RGB uint8 HWC; depth float32 HW in metres, 0 = missing.

OpenCV fills the lost half of a truncated JPEG with grey and says nothing, so the bytes are checked before decoding.
"""

import zlib
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ebjax.io.camera_file import CameraFile

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
NO_DEPTH = 65535


class BrokenFrame(ValueError):  # noqa: N818 - a frame to skip, not an error to stop at
    """A frame that cannot be used; the message names its file and what is wrong with it."""


def jpeg_is_whole(content: bytes) -> bool:
    """Tells whether a JPEG's scan reaches its end-of-image marker.

    The search starts behind the header segments: an embedded thumbnail has an end marker of its own.
    """
    position = 2
    while position + 4 <= len(content) and content[position] == 0xFF:
        marker = content[position + 1]
        if marker == 0xDA:
            return content.find(b"\xff\xd9", position) >= 0
        if marker == 0xFF or marker == 0x01 or 0xD0 <= marker <= 0xD7:
            position += 1 if marker == 0xFF else 2
        else:
            position += 2 + int.from_bytes(content[position + 2 : position + 4], "big")
    return False


def png_is_whole(content: bytes) -> bool:
    """Tells whether a PNG's chunks reach IEND with the right checksums."""
    position = len(PNG_SIGNATURE)
    while position + 12 <= len(content):
        end = position + 12 + int.from_bytes(content[position : position + 4], "big")
        checksum = int.from_bytes(content[end - 4 : end], "big")
        if end > len(content) or zlib.crc32(content[position + 4 : end - 4]) != checksum:
            return False
        if content[position + 4 : position + 8] == b"IEND":
            return True
        position = end
    return False


def _decode(path: Path, flags: int) -> np.ndarray:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BrokenFrame(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    if not content:
        raise BrokenFrame(f"{path}: the file is empty")
    if content[:2] == b"\xff\xd8" and not jpeg_is_whole(content):
        raise BrokenFrame(f"{path}: truncated JPEG; copy it again")
    if content[:8] == PNG_SIGNATURE and not png_is_whole(content):
        raise BrokenFrame(f"{path}: truncated or damaged PNG; copy it again")
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise BrokenFrame(f"{path}: not an image that OpenCV can decode; give JPEG or PNG")
    return image


def check_size(path: str | Path, image: np.ndarray, size: tuple[int, int] | None) -> None:
    """Raises BrokenFrame where an image has not the camera's (width, height)."""
    height, width = image.shape[:2]
    if size is not None and (width, height) != size:
        raise BrokenFrame(f"{path}: {width}x{height} pixels, but the camera has {size[0]}x{size[1]}")


def read_image(path: str | Path, size: tuple[int, int] | None = None) -> UInt8[np.ndarray, "H W 3"]:
    """Reads an image file as RGB, 0-255; grey images get three equal channels.

    Args:
      path: JPEG, PNG or anything else that OpenCV decodes.
      size: (width, height) that it must have.

    Raises:
      BrokenFrame: (a ValueError) missing, empty, truncated, not an image, or another size; names the file.
    """
    path = Path(path)
    image = _decode(path, cv2.IMREAD_COLOR)
    check_size(path, image, size)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)  # type: ignore[return-value]


def read_depth(path: str | Path, depth_scale: float, size: tuple[int, int] | None = None) -> Float[np.ndarray, "H W"]:
    """Reads depth along the optical axis, file value / depth_scale, float32 metres; 0 means missing.

    Zero, 65535 (what some sensors write where they see nothing), negative, NaN and infinite values become 0.

    Args:
      path: 16-bit PNG, or a float TIFF.
      depth_scale: file units per metre (1000 for millimetres).
      size: (width, height) that it must have.

    Raises:
      BrokenFrame: as `read_image`; and when the file is not one channel of 16-bit or float depth.
    """
    path = Path(path)
    raw = _decode(path, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2 or raw.dtype not in (np.uint16, np.float32, np.float64):
        channels = 1 if raw.ndim == 2 else raw.shape[2]
        raise BrokenFrame(f"{path}: {channels} channel(s) of {raw.dtype}; depth is one channel of 16 bits")
    check_size(path, raw, size)
    present = np.isfinite(raw) & (raw > 0) & (raw != NO_DEPTH) if raw.dtype != np.uint16 else raw != NO_DEPTH
    return np.where(present, raw.astype(np.float32) / np.float32(depth_scale), np.float32(0))


def fitted_depth(name: str, depth_m: Float[np.ndarray, "h w"], size: tuple[int, int]) -> Float[np.ndarray, "H W"]:
    """Depth at the (width, height) of the image it belongs to: the nearest of its values where the sizes differ.

    Raises:
      BrokenFrame: it has another shape than the image; gives its name.
    """
    height, width = depth_m.shape
    if (width, height) == size:
        return depth_m
    if abs(width * size[1] - height * size[0]) > max(*size, width, height):
        raise BrokenFrame(f"{name}: {width}x{height} pixels, another shape than the camera's {size[0]}x{size[1]}")
    return cv2.resize(depth_m, size, interpolation=cv2.INTER_NEAREST_EXACT)  # type: ignore[return-value]


def depth_share(depth_m: Float[np.ndarray, "H W"]) -> float:
    """Returns the share of pixels that have depth (finite and above zero), in [0, 1]."""
    return float(np.mean(np.isfinite(depth_m) & (depth_m > 0)))


def read_both(
    a: Path, b: Path, size: tuple[int, int] | None = None
) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W 3"]]:
    """Reads two images of one (width, height), the camera's where it is given.

    Raises:
      ValueError: an unreadable file, or two sizes.
    """
    images = read_image(a, size), read_image(b, size)
    if images[0].shape != images[1].shape:
        sizes = [f"{image.shape[1]}x{image.shape[0]}" for image in images]
        raise ValueError(f"{b}: {sizes[1]} pixels, but {a} has {sizes[0]}; give two images of one camera")
    return images


def read_depths(a: Path, b: Path, camera: CameraFile) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Reads two depth images of one camera.

    Raises:
      ValueError: an unreadable file, another size than the camera's, or no depth in it at all.
    """
    depths = []
    for path in (a, b):
        depth = read_depth(path, camera.depth_scale, (camera.width, camera.height))
        if depth_share(depth) == 0:
            raise ValueError(f"{path}: no pixel has depth; check the file and depth_scale, or leave the depth out")
        depths.append(depth)
    return depths[0], depths[1]
