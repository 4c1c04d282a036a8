"""RTAB-Map's calibration blobs: serialised camera models (since 0.18.0) and rows of floats (before)."""

import struct
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SERIALISED_SINCE = (0, 18, 0)
MONO, STEREO = 0, 1
OLD_MONO_BYTES, OLD_STEREO_BYTES = 72, 76
MOST_PX = 1_000_000


@dataclass(frozen=True)
class DatabaseCamera:
    """A camera as the database describes it.

    Attributes:
      width: px; 0 where the database does not say.
      height: px; 0 where the database does not say.
      raw: K, px, of the image before rectification; None where not given.
      distortion: OpenCV's coefficients; 6 are a fisheye's, k1 k2 0 0 k3 k4.
      rotation: R, rectified_from_raw.
      projection: the first three columns of P: K of the rectified image.
      base_from_camera: p_base = base_from_camera @ p_camera, m; None where not given.
      stereo: whether the depth column holds the right image of a pair.
    """

    width: int
    height: int
    raw: Float[np.ndarray, "3 3"] | None
    distortion: tuple[float, ...]
    rotation: Float[np.ndarray, "3 3"] | None
    projection: Float[np.ndarray, "3 3"] | None
    base_from_camera: Float[np.ndarray, "4 4"] | None
    stereo: bool

    @property
    def rectified(self) -> Float[np.ndarray, "3 3"] | None:
        """K of the rectified image, px: P's, else K."""
        return self.raw if self.projection is None else self.projection

    @property
    def looks_raw(self) -> bool:
        """Tells whether the lens bends but P is K and R the identity, which no rectification gives."""
        unchanged = self.projection is None or (self.raw is not None and np.allclose(self.projection, self.raw))
        unrotated = self.rotation is None or np.allclose(self.rotation, np.eye(3))
        return any(self.distortion) and self.raw is not None and bool(unchanged and unrotated)


def transform_from_floats(values: Float[np.ndarray, "12"]) -> Float[np.ndarray, "4 4"] | None:
    """Makes a rigid transform of a row-major 3x4 [R|t] and removes the rounding of R; None where it is null.

    Raises:
      ValueError: R is not a rotation.
    """
    if not np.isfinite(values).all() or not values.any():
        return None
    pose = np.eye(4)
    pose[:3] = values.reshape(3, 4)
    left, stretch, right = np.linalg.svd(pose[:3, :3])
    if np.abs(stretch - 1).max() > 1e-2 or np.linalg.det(pose[:3, :3]) < 0:
        raise ValueError("a transform whose 3x3 part is not a rotation")
    pose[:3, :3] = left @ right
    return pose


class _Reader:
    """Takes arrays off the front of a blob."""

    def __init__(self, blob: bytes) -> None:
        self.blob, self.position = blob, 0

    def take(self, dtype: str, count: int) -> np.ndarray:
        """The next numbers, float64 where they are not whole ones; raises ValueError where the blob ends."""
        size = np.dtype(dtype).itemsize * count
        if count < 0 or self.position + size > len(self.blob):
            raise ValueError(f"a calibration of {len(self.blob)} bytes that ends too early")
        values = np.frombuffer(self.blob, dtype, count, self.position)
        self.position += size
        return values if dtype == "<i4" else values.astype(np.float64)

    def model(self) -> DatabaseCamera:
        """The next model: one camera, or the left one of a stereo pair."""
        _, _, _, kind = struct.unpack("<4i", self.take("<i4", 4).tobytes())
        if kind == STEREO:
            counts = self.take("<i4", 6)
            for count in counts[:4]:
                self.take("<f8", int(count))
            end = self.position + int(counts[4]) + int(counts[5])
            left = self.model()
            self.position = end
            return DatabaseCamera(**{**vars(left), "stereo": True})
        if kind != MONO:
            raise ValueError(f"a calibration of kind {kind}, which is not known")
        width, height, *counts_of = self.take("<i4", 7).tolist()
        _check_size(width, height)
        k, d, r, p = (self.take("<f8", count) for count in counts_of[:4])
        mount = self.take("<f4", counts_of[4])
        if {len(k), len(r)} - {0, 9} or len(p) not in (0, 12) or len(mount) not in (0, 12):
            raise ValueError(f"a calibration whose matrices have {counts_of} numbers")
        if len(d) not in (0, 4, 5, 6, 8, 12, 14):
            raise ValueError(f"a calibration with {len(d)} distortion coefficients")
        return DatabaseCamera(
            width,
            height,
            raw=k.reshape(3, 3) if k.any() else None,
            distortion=tuple(d.tolist()),
            rotation=r.reshape(3, 3) if r.any() else None,
            projection=p.reshape(3, 4)[:, :3] if p.any() else None,
            base_from_camera=transform_from_floats(mount) if len(mount) else None,
            stereo=False,
        )


def _check_size(width: float | int, height: float | int) -> None:
    if not (0 <= width <= MOST_PX and 0 <= height <= MOST_PX):
        raise ValueError(f"a calibration of images of {width:g} x {height:g} px")


def _camera_from_row(row: Float[np.ndarray, " n"], stereo: bool) -> DatabaseCamera:
    fx, fy, cx, cy = row[:4]
    width, height = row[-14:-12]
    _check_size(width, height)
    k = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return DatabaseCamera(int(width), int(height), k, (), None, None, transform_from_floats(row[-12:]), stereo)


def cameras_from_blob(blob: bytes, version: tuple[int, ...]) -> tuple[DatabaseCamera, ...]:
    """Reads the cameras of a node, in the order in which their images stand side by side.

    Before 0.18.0: float32 rows fx fy cx cy width height T(12); a stereo pair fx fy cx cy baseline width height T(12).

    Raises:
      ValueError: no known layout; does not name the file.
    """
    if version < SERIALISED_SINCE:
        if not blob or (len(blob) != OLD_STEREO_BYTES and len(blob) % OLD_MONO_BYTES):
            raise ValueError(f"a calibration of {len(blob)} bytes, which is no known layout")
        stereo = len(blob) == OLD_STEREO_BYTES
        rows = np.frombuffer(blob, "<f4").astype(np.float64).reshape(-1, 19 if stereo else 18)
        return tuple(_camera_from_row(row, stereo) for row in rows)
    reader, cameras = _Reader(blob), []
    while reader.position < len(blob):
        cameras.append(reader.model())
    return tuple(cameras)
