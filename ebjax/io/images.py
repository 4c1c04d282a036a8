"""Images from files: decoded only if whole and as stored, RGB uint8 HWC.

OpenCV fills the lost half of a truncated JPEG with grey and says nothing, so the bytes are checked before decoding. It
turns pictures by their EXIF orientation, but a calibration belongs to the pixels as stored: they are turned only where
that alone gives the camera's size.
"""

import io
import zlib
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from ebjax.io.exif import Exif, without_orientation
from ebjax.io.grey_levels import bits_for, eight_bits
from ebjax.io.image_header import PNG_SIGNATURE, TIFFS, header_of, read_header
from ebjax.io.image_kinds import conversion, unread_kind
from ebjax.io.opencv_log import quiet
from ebjax.io.orientation import upright

MOST_PX = 1 << 28
WHITE = 65535
COLOUR = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION


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


def read_stored(path: Path, flags: int) -> tuple[np.ndarray, Exif]:
    """Decodes a file into the pixels that it stores, whatever its EXIF orientation, which is returned beside them.

    Args:
      path: JPEG, PNG or anything else that OpenCV decodes.
      flags: OpenCV's, of what is wanted.

    Raises:
      BrokenFrame: missing, empty, truncated, too large, an animation, or no image; names the file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BrokenFrame(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    except ValueError:
        raise BrokenFrame(f"{str(path)!r}: no name of a file") from None
    if not content:
        raise BrokenFrame(f"{path}: the file is empty")
    if kind := unread_kind(path, content[:32]):
        raise BrokenFrame(f"{path}: {kind}")
    if content[:2] == b"\xff\xd8" and not jpeg_is_whole(content):
        raise BrokenFrame(f"{path}: truncated JPEG; copy it again")
    if content[:8] == PNG_SIGNATURE and not png_is_whole(content):
        raise BrokenFrame(f"{path}: truncated or damaged PNG; copy it again")
    header = header_of(io.BytesIO(content))
    if header is not None:
        if header.raw:
            raise BrokenFrame(f"{path}: a camera's raw picture, which is not read; {conversion(path)}")
        if header.animated:
            raise BrokenFrame(f"{path}: an animation, not one image; save its frames as images, or as a video")
        if header.width * header.height > MOST_PX:
            raise BrokenFrame(f"{path}: {header.width}x{header.height} pixels, more than {MOST_PX}; give it smaller")
    if content[:4] in TIFFS:
        content = without_orientation(content)
    try:
        with quiet() if header is None or content[:4] in TIFFS else nullcontext():
            image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
            if image is None and header is not None and header.floats:
                image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, MemoryError):
        image = None
    if image is None:
        raise BrokenFrame(f"{path}: not an image that OpenCV can decode; give JPEG or PNG")
    return image, Exif() if header is None else header.exif


def same_shape(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether one (width, height) is another times a factor, to a pixel."""
    return abs(a[0] * b[1] - a[1] * b[0]) <= max(*a, *b)


def check_size(path: str | Path, image: np.ndarray, size: tuple[int, int] | None) -> None:
    """Raises BrokenFrame where an image has not the camera's (width, height)."""
    height, width = image.shape[:2]
    if size is not None and (width, height) != size:
        raise BrokenFrame(f"{path}: {width}x{height} pixels, but the camera has {size[0]}x{size[1]}")


def fitting(image: np.ndarray, exif: Exif, size: tuple[int, int] | None) -> np.ndarray:
    """The stored pixels, or these turned as EXIF asks where only that has the (width, height) that is wanted."""
    if size is not None and exif.sideways and image.shape[:2] == size and size[0] != size[1]:
        return upright(image, exif.orientation)
    return image


def read_fitting(path: str | Path, size: tuple[int, int] | None = None, bits: int | None = None) -> np.ndarray:
    """As `read_image`, of whatever size."""
    path = Path(path)
    image, exif = read_stored(path, COLOUR)
    if image.dtype not in (np.uint8, np.uint16):
        raise BrokenFrame(f"{path}: pixels of {image.dtype}, which have no fixed white; save it with 8 or 16 bits")
    if image.dtype == np.uint16:
        image = eight_bits(image, bits or bits_for(int(image.max()) or WHITE))
    return cv2.cvtColor(fitting(image, exif, size), cv2.COLOR_BGR2RGB)


def read_image(
    path: str | Path, size: tuple[int, int] | None = None, *, bits: int | None = None
) -> UInt8[np.ndarray, "H W 3"]:
    """Reads an image file as RGB, 0-255, as stored; grey images get three equal channels, alpha is left out.

    Args:
      path: JPEG, PNG or anything else that OpenCV decodes.
      size: (width, height) that it must have; it is turned as its EXIF asks if it has it then and not as stored.
      bits: how many of 16 bits the images of its camera use; None: by the image itself.

    Raises:
      BrokenFrame: (a ValueError) missing, empty, truncated, not an image, or another size; names the file.
    """
    image = read_fitting(path, size, bits)
    check_size(path, image, size)
    return image


def shared_bits(paths: Sequence[Path]) -> int | None:
    """How many of 16 bits several images of one camera use; None where none that can be read has so many."""
    brightest = []
    for path in paths:
        if (header := read_header(path)) is not None and header.bits <= 8:
            continue
        try:
            image = read_stored(path, COLOUR)[0]
        except BrokenFrame:
            continue
        if image.dtype == np.uint16:
            brightest.append(int(image.max()))
    return bits_for(max(brightest) or WHITE) if brightest else None


def read_both(
    a: Path, b: Path, size: tuple[int, int] | None = None
) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W 3"]]:
    """Reads two images of one (width, height), the camera's where it is given.

    Raises:
      ValueError: an unreadable file, or two sizes.
    """
    bits = shared_bits([Path(a), Path(b)])
    images = read_fitting(a, size, bits), read_fitting(b, size, bits)
    if images[0].shape != images[1].shape:
        sizes = [f"{image.shape[1]}x{image.shape[0]}" for image in images]
        raise ValueError(f"{b}: {sizes[1]} pixels, but {a} has {sizes[0]}; give two images of one camera")
    check_size(a, images[0], size)
    return images
