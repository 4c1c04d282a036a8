"""Colour images of ROS messages as RGB uint8: every raw encoding, JPEG and PNG."""

from types import SimpleNamespace

import cv2
import numpy as np
from jaxtyping import UInt8

from ebjax.io.grey_levels import bits_for, eight_bits
from ebjax.io.images import PNG_SIGNATURE, jpeg_is_whole, png_is_whole
from ebjax.io.logs.bag_index import EXTRA
from ebjax.io.logs.ros_message import Image
from ebjax.io.one_line import one_line

# cv_bridge takes images without a named colour as OpenCV has them.
SAME_AS = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC1": "mono16", "16UC3": "bgr16", "y8": "mono8"}
SAME_AS |= {"yuv422": "uyvy", "yuv422_yuy2": "yuyv", "16uc1": "mono16", "8uc1": "mono8", "8uc3": "bgr8"}
TALLER = ("nv12", "nv21")
JPEG_START = b"\xff\xd8"


def rows_from(image: Image, dtype: np.dtype, channels: int, height: int) -> np.ndarray:
    """The pixels of a raw message without the padding of its rows, in the machine's byte order.

    Raises:
      ValueError: fewer bytes than rows.
    """
    used = image.width * channels * dtype.itemsize
    step = max(image.step, used) if height > 1 else used
    if len(image.data) < step * height - (step - used) or not used:
        raise ValueError(f"truncated image: {len(image.data)} bytes for {image.width} x {image.height} px")
    padded = np.zeros(step * height, np.uint8)
    padded[: len(image.data)] = np.frombuffer(image.data, np.uint8)[: step * height]
    rows = np.ascontiguousarray(padded.reshape(height, step)[:, :used])
    stored = dtype.newbyteorder(">" if image.is_bigendian else "<")
    return rows.view(stored).astype(dtype).reshape((height, image.width) + ((channels,) if channels > 1 else ()))


def brightest(image: Image, is_packed: bool) -> int | None:
    """The largest value of a grey image of more than 8 bits; None of another.

    Raises:
      ValueError: it cannot be decoded.
    """
    if not is_packed:
        if SAME_AS.get(image.encoding, image.encoding) != "mono16":
            return None
        return int(rows_from(image, np.dtype(np.uint16), 1, image.height).max(initial=0))
    if bytes(image.data[:2]) == JPEG_START:
        return None
    pixels = decoded(image.data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    return int(pixels.max(initial=0)) if pixels.dtype == np.uint16 else None


def _eight_bits(grey: np.ndarray, bits: int | None) -> np.ndarray:
    return eight_bits(grey, bits_for(int(grey.max(initial=0))) if bits is None else bits)


def raw_from(image: Image, bits: int | None = None) -> UInt8[np.ndarray, "H W 3"]:
    """A raw image as RGB; 16-bit grey is scaled by the bits in use: `bits`, or those of this image.

    Raises:
      ValueError: an unknown encoding, too few bytes, or rosbags-image is missing.
    """
    try:
        from rosbags.image import message_to_cvimage
        from rosbags.image.image import ImageError, to_cvtype
    except ImportError:
        raise ValueError(f"raw images need rosbags-image: {EXTRA}") from None
    encoding = SAME_AS.get(image.encoding, image.encoding)
    try:
        _, _, name, channels = to_cvtype(encoding)
        height = image.height * 3 // 2 if encoding in TALLER else image.height
        pixels = rows_from(image, np.dtype(name), channels, height)
        if encoding == "mono16":
            encoding, pixels = "mono8", _eight_bits(pixels, bits)
        message = SimpleNamespace(
            encoding=encoding, height=height, width=image.width, is_bigendian=0, data=pixels.reshape(-1).view(np.uint8)
        )
        rgb = message_to_cvimage(message, "rgb8")  # type: ignore[arg-type]
    except (ImageError, cv2.error) as error:
        raise ValueError(f"images of encoding {image.encoding[:40]!r} cannot be read ({one_line(error)})") from None
    return np.ascontiguousarray(rgb.astype(np.uint8, copy=False))


def decoded(content: memoryview, flags: int) -> np.ndarray:
    """Decodes a JPEG, a PNG or what else OpenCV knows, if it is whole.

    Raises:
      ValueError: truncated, or not an image.
    """
    content_bytes = bytes(content)
    if content_bytes[:2] == JPEG_START and not jpeg_is_whole(content_bytes):
        raise ValueError("truncated JPEG")
    if content_bytes[:8] == PNG_SIGNATURE and not png_is_whole(content_bytes):
        raise ValueError("truncated or damaged PNG")
    try:
        pixels = cv2.imdecode(np.frombuffer(content_bytes, np.uint8), flags) if content_bytes else None
    except cv2.error:
        pixels = None
    if pixels is None:
        raise ValueError("not an image that OpenCV can decode")
    return pixels


def compressed_from(image: Image, bits: int | None = None) -> UInt8[np.ndarray, "H W 3"]:
    """A compressed image as RGB, its channels in the order that its format tells.

    The format is "encoding; codec compressed encoding". ROS stores BGR where the last says bgr, else RGB; a format
    without a semicolon means BGR.
    """
    encoding, separator, stored = image.encoding.partition(";")
    pixels = decoded(image.data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels.dtype == np.uint16:
        pixels = _eight_bits(pixels, bits)
    if pixels.ndim == 2:
        bayer = encoding.strip() if encoding.startswith("bayer") else "mono8"
        height, width = pixels.shape
        grey = Image(image.header, width, height, bayer.replace("16", "8"), False, width, memoryview(pixels.tobytes()))
        return raw_from(grey)
    is_colour = encoding.strip().startswith(("rgb", "bgr"))
    is_rgb = bool(separator) and is_colour and "compressed bgr" not in stored
    return np.ascontiguousarray(pixels[:, :, :3] if is_rgb else pixels[:, :, 2::-1])
