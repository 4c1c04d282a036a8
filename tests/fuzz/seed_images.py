"""Seeds that are pictures: PNG, JPEG with EXIF, TIFF and others; depth; masks; RVL and compressedDepth payloads."""

import struct

import cv2
import numpy as np

from ebjax.io.logs import rvl

from .mutate import Input


def pixels(width: int, height: int) -> np.ndarray:
    """A picture of few colours, uint8 H W 3."""
    across, down = np.meshgrid(np.linspace(0, 200, width), np.linspace(0, 100, height))
    return np.stack([across, down, across / 2 + down], 2).astype(np.uint8)


def written(suffix: str, image: np.ndarray, *options: int) -> bytes:
    """The content of a picture's file."""
    return cv2.imencode(suffix, image, list(options))[1].tobytes()


def png_of(width: int, height: int) -> bytes:
    return written(".png", pixels(width, height))


def jpeg_of(width: int, height: int) -> bytes:
    return written(".jpg", pixels(width, height))


def exif(orientation: int = 6, taken: bytes = b"2024:05:06 07:08:09\0") -> bytes:
    """The APP1 segment of a JPEG with orientation and time."""
    inner = struct.pack("<H HHII I", 1, 0x9003, 2, len(taken), 56, 0) + taken
    head = b"II*\0" + struct.pack("<I H HHIHH HHII I", 8, 2, 0x0112, 3, 1, orientation, 0, 0x8769, 4, 1, 38, 0)
    body = b"Exif\0\0" + head + inner
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


def jpeg_with_exif(width: int = 32, height: int = 24, **options: int) -> bytes:
    content = jpeg_of(width, height)
    return content[:2] + exif(**options) + content[2:]


def depth_mm() -> np.ndarray:
    """Millimetres with a few missing pixels."""
    depth = (1000 + 3 * np.arange(24 * 32)).reshape(24, 32).astype(np.uint16)
    depth[:2] = 0
    return depth


def images() -> list[Input]:
    colour, alpha = pixels(32, 24), np.dstack([pixels(32, 24), np.full((24, 32), 255, np.uint8)])
    alpha[:6, :, 3] = 0
    grey16 = pixels(32, 24)[..., 0].astype(np.uint16) * 256
    contents = {
        "a.png": png_of(32, 24), "alpha.png": written(".png", alpha), "grey16.png": written(".png", grey16),
        "a.jpg": jpeg_of(32, 24), "exif.jpg": jpeg_with_exif(), "progressive.jpg":
        written(".jpg", colour, cv2.IMWRITE_JPEG_PROGRESSIVE, 1), "a.bmp": written(".bmp", colour),
        "a.tiff": written(".tiff", colour), "a.webp": written(".webp", colour), "a.ppm": written(".ppm", colour),
        "a.pgm": written(".pgm", colour[..., 0]), "float.tiff": written(".tiff", colour[..., 0].astype(np.float32)),
    }  # fmt: skip
    return [Input({name: content}, name) for name, content in contents.items()]


def depths() -> list[Input]:
    metres = depth_mm().astype(np.float32) / 1000
    contents = {"mm.png": written(".png", depth_mm()), "metres.tiff": written(".tiff", metres)}
    return [Input({name: content}, name) for name, content in contents.items()]


def masks() -> list[Input]:
    mask = np.full((24, 32), 255, np.uint8)
    mask[:8] = 0
    alpha = np.dstack([pixels(32, 24), mask])
    contents = {"black.png": written(".png", mask), "alpha.png": written(".png", alpha), "a.jpg": written(".jpg", mask)}
    contents["double.png"] = written(".png", mask.repeat(2, 0).repeat(2, 1))
    return [Input({name: content}, name) for name, content in contents.items()]


def payloads() -> list[Input]:
    """Depth as RTAB-Map's database and as compressed_depth_image_transport keep it."""
    depth = depth_mm()
    packed = rvl.encode(depth)
    size = struct.pack("<2I", depth.shape[1], depth.shape[0])
    as_float = (depth / np.float32(1000)).astype("<f4").view(np.uint8).reshape(*depth.shape, 4)
    contents = {
        "rtabmap.rvl": b"DEPTHRVL" + size + packed, "rtabmap.png": written(".png", depth), "rtabmap_float.png":
        written(".png", as_float), "ros_16UC1.png": struct.pack("<iff", 0, 0, 0) + written(".png", depth),
        "ros_32FC1.png": struct.pack("<iff", 0, 10100.0, -1009.0) + written(".png", depth),
        "ros_16UC1.rvl": struct.pack("<iff", 0, 0, 0) + size + packed, "ros_32FC1.rvl":
        struct.pack("<iff", 0, 10100.0, -1009.0) + size + packed,
    }  # fmt: skip
    return [Input({name: content}, name) for name, content in contents.items()]
