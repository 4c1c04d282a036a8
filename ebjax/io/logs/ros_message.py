"""Reads the few ROS messages that a log is made of, from ROS 1's bytes or ROS 2's CDR. Times are ns, quaternions wxyz.

Their layouts have never changed, so that no message definition is needed; other types are never read.
"""

import struct
from dataclasses import dataclass

from ebjax.io.one_line import printable

IMAGE, COMPRESSED = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
CAMERA_INFO, ODOMETRY = "sensor_msgs/CameraInfo", "nav_msgs/Odometry"
TRANSFORM, IMU = "geometry_msgs/TransformStamped", "sensor_msgs/Imu"
POSES = (ODOMETRY, TRANSFORM, "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped")
TF = ("tf2_msgs/TFMessage", "tf/tfMessage")
HEAD = 512


class Cursor:
    """Reads a message from its start on.

    Raises:
      ValueError: from every method, when the bytes end too early.
    """

    def __init__(self, content: bytes, encoding: str):
        self.content, self.is_cdr = content, encoding == "cdr"
        self.position = 4 if self.is_cdr else 0
        self.order = ">" if self.is_cdr and content[1:2] == b"\0" else "<"

    def numbers(self, kind: str, count: int = 1) -> tuple:
        """`count` numbers of one kind, as `struct` names it."""
        size = struct.calcsize("=" + kind)
        if self.is_cdr and count:
            self.position += -(self.position - 4) % size
        start, self.position = self.position, self.position + size * count
        try:
            return struct.unpack_from(f"{self.order}{count}{kind}", self.content, start)
        except struct.error:
            raise ValueError("a truncated message") from None

    def number(self, kind: str = "I") -> int:
        """One number."""
        return self.numbers(kind)[0]

    def bytes(self) -> memoryview:
        """A sequence of bytes: all of it, or what there is of it."""
        size = self.number()
        start, self.position = self.position, self.position + size
        return memoryview(self.content)[start : start + size]

    def text(self) -> str:
        """A string."""
        size = self.number()
        start, self.position = self.position, self.position + size
        if self.position > len(self.content):
            raise ValueError("a truncated message")
        return printable(self.content[start : self.position].rstrip(b"\0").decode("utf-8", "replace"))


@dataclass(frozen=True)
class Header:
    """A message's stamp and its frame, without a leading slash."""

    stamp_ns: int
    frame_id: str


@dataclass(frozen=True)
class Image:
    """An image message; `encoding` is the format of a compressed one, whose size is 0 x 0."""

    header: Header
    width: int
    height: int
    encoding: str
    is_bigendian: bool
    step: int
    data: memoryview


@dataclass(frozen=True)
class CameraInfo:
    """A CameraInfo message; the region of interest is x, y, width, height."""

    header: Header
    width: int
    height: int
    model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    P: tuple[float, ...]
    binning: tuple[int, int]
    roi: tuple[int, int, int, int]


@dataclass(frozen=True)
class Transform:
    """parent_from_child of one time, x y z and quaternion."""

    header: Header
    child: str
    translation: tuple[float, ...]
    quaternion: tuple[float, ...]


def header_from(cursor: Cursor) -> Header:
    """Reads a std_msgs/Header."""
    if not cursor.is_cdr:
        cursor.number()
    sec, nsec = cursor.number("i" if cursor.is_cdr else "I"), cursor.number()
    return Header(sec * 10**9 + nsec, cursor.text().strip("/"))


def image_from(content: bytes, encoding: str, kind: str) -> Image:
    """Reads an Image or a CompressedImage; the first bytes alone give all but the data."""
    cursor = Cursor(content, encoding)
    header = header_from(cursor)
    if kind == COMPRESSED:
        return Image(header, 0, 0, cursor.text(), False, 0, cursor.bytes())
    height, width = cursor.number(), cursor.number()
    name, is_bigendian, step = cursor.text(), bool(cursor.number("B")), cursor.number()
    return Image(header, width, height, name, is_bigendian, step, cursor.bytes())


def camera_info_from(content: bytes, encoding: str) -> CameraInfo:
    """Reads a CameraInfo."""
    cursor = Cursor(content, encoding)
    header = header_from(cursor)
    height, width, model = cursor.number(), cursor.number(), cursor.text()
    D = cursor.numbers("d", cursor.number())
    K, _, P = cursor.numbers("d", 9), cursor.numbers("d", 9), cursor.numbers("d", 12)
    binning = (cursor.number(), cursor.number())
    x, y, rows, columns = cursor.numbers("I", 4)
    return CameraInfo(header, width, height, model, D, K, P, binning, (x, y, columns, rows))


def _pose(cursor: Cursor) -> tuple[tuple[float, ...], tuple[float, ...]]:
    x, y, z, qx, qy, qz, qw = cursor.numbers("d", 7)
    return (x, y, z), (qw, qx, qy, qz)


def transforms_from(content: bytes, encoding: str) -> list[Transform]:
    """Reads a TFMessage."""
    cursor, transforms = Cursor(content, encoding), []
    for _ in range(cursor.number()):
        header, child = header_from(cursor), cursor.text().strip("/")
        transforms.append(Transform(header, child, *_pose(cursor)))
    return transforms


def orientation_from(content: bytes, encoding: str) -> Transform | None:
    """Reads an Imu as a pose without a place; None where it says that it has no orientation."""
    cursor = Cursor(content, encoding)
    header = header_from(cursor)
    x, y, z, w = cursor.numbers("d", 4)
    unknown = cursor.numbers("d", 9)[0] == -1
    return None if unknown else Transform(header, "", (0.0, 0.0, 0.0), (w, x, y, z))


def pose_from(content: bytes, encoding: str, kind: str) -> Transform:
    """Reads one of `POSES`; a PoseStamped has no child frame."""
    cursor = Cursor(content, encoding)
    header = header_from(cursor)
    child = cursor.text().strip("/") if kind in (ODOMETRY, TRANSFORM) else ""
    return Transform(header, child, *_pose(cursor))
