"""Opens a robot's log of any known kind, recognised by what is in it."""

import contextlib
import sqlite3
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from ebjax.io.image_folder import SUFFIXES
from ebjax.io.image_kinds import SUFFIXES as UNREAD
from ebjax.io.logs.image_layouts import layout_reader
from ebjax.io.logs.lacking import READ, folder_refusal
from ebjax.io.logs.log import Log
from ebjax.io.logs.log_clock import log_in_seconds
from ebjax.io.logs.photographs import open_images
from ebjax.io.logs.ros_bag import open_bag
from ebjax.io.logs.rtabmap import open_rtabmap
from ebjax.io.logs.tum_folder import open_tum_folder
from ebjax.io.logs.video import open_video
from ebjax.io.map_file.schema import APPLICATION_ID
from ebjax.parts import find

MAP = APPLICATION_ID.to_bytes(4, "big")
"""The application id in the header of an SQLite file."""
SQLITE, ROSBAG, MCAP, ZSTD = b"SQLite format 3\x00", b"#ROSBAG", b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd"
BAG_SUFFIXES = (".db3", ".mcap", ".zstd")


@dataclass(frozen=True)
class Topics:
    """Topics of a bag that are used in place of those that are chosen by their types."""

    image: str | None = None
    """Of the colour images."""
    depth: str | None = None
    """Of the depth images."""
    camera_info: str | None = None
    """Of the camera's calibration."""
    odometry: str | None = None
    """Of the odometry, nav_msgs/Odometry."""
    truth: str | None = None
    """Of the ground truth: it is read only where it is named."""
    imu: str | None = None
    """Of an IMU with orientation: its roll and pitch enter odometry that has none."""


@dataclass(frozen=True)
class LogOptions:
    """What is taken of a log that holds more than one of it."""

    topics: Topics = field(default_factory=Topics)
    session: int | None = None
    """Of an RTAB-Map database with several sessions: its number (map_id). None: the one with most images."""
    camera_index: int | None = None
    """Of several cameras side by side: its number. None: the one that looks at the floor."""
    images: Literal["rectified", "raw"] = "rectified"
    """How an RTAB-Map database's images are understood: rectified, as RTAB-Map does, or raw, bent by the lens."""
    frames_per_s: float | None = None
    """Of a video or a folder of images that tells no times."""
    reader: str | None = None
    """Reads a kind of log that ebjax does not know: package.module:NAME, a function of your own of the log's path that
    returns an `ebjax.io.logs.log.Log`. Its code is run."""


DEFAULT = LogOptions()
OPTIONS = (
    ("topics", ("bag",), "ROS bags"),
    ("session", ("rtabmap",), "RTAB-Map databases"),
    ("camera_index", ("rtabmap",), "RTAB-Map databases"),
    ("images", ("rtabmap",), "RTAB-Map databases"),
    ("frames_per_s", ("video", "images"), "videos and folders of images"),
)
"""Field, the kinds of log that it is for, and these in words."""


def open_log(
    path: str | Path, options: LogOptions = DEFAULT, *, depth: bool = True, depth_scale: float | None = None
) -> Log:
    """Opens a TUM folder, a ROS bag (1, 2, mcap; file or folder), an RTAB-Map database, a video or a folder of images.

    Args:
      path: file or folder.
      options: see there.
      depth: whether to look for depth in a TUM folder.
      depth_scale: depth file units per metre of a TUM folder; None: as its camera.json says.

    Raises:
      ValueError: nothing there, nothing that is read, or a fault in it; names file and remedy.
    """
    if options.reader is not None:
        _check_options(path, "your own reader", options)
        return log_in_seconds(_read_by(options.reader, Path(path)))
    kind = kind_of(path)
    _check_options(path, kind, options)
    return log_in_seconds(_opened(path, kind, options, depth, depth_scale))


def _read_by(reader: str, path: Path) -> Log:
    found = find("reader", reader, {})
    if not callable(found):
        raise ValueError(f"reader {reader!r} is a {type(found).__name__}; give a function of the log's path")
    log = found(path)
    if not isinstance(log, Log):
        raise ValueError(f"reader {reader!r} returned a {type(log).__name__}; it must return an ebjax.io.logs.log.Log")
    return log


def _opened(path: str | Path, kind: str, options: LogOptions, depth: bool, depth_scale: float | None) -> Log:
    if kind == "bag":
        return open_bag(path, topics={role: topic for role, topic in asdict(options.topics).items() if topic})
    if kind == "rtabmap":
        return open_rtabmap(path, session=options.session, camera_index=options.camera_index, images=options.images)
    if kind == "video":
        return open_video(path, frames_per_s=options.frames_per_s)
    if kind == "images":
        return open_images(path, frames_per_s=options.frames_per_s)
    return open_tum_folder(path, depth=depth, depth_scale=depth_scale)


def _check_options(path: str | Path, kind: str, options: LogOptions) -> None:
    """Refuses what is said of another kind of log."""
    for name, kinds, words in OPTIONS:
        if getattr(options, name) != getattr(DEFAULT, name) and kind not in kinds:
            flag = "--topics.*" if name == "topics" else f"--{name.replace('_', '-')}"
            raise ValueError(f"{path}: {flag} is for {words}; leave it out here")


def kind_of(path: str | Path) -> Literal["tum", "bag", "rtabmap", "video", "images"]:
    """Which reader takes a path, by its first bytes or by what is in the folder."""
    path = Path(path)
    if path.is_dir():
        return _folder_kind(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such folder or file; give {READ}")
    with open(path, "rb") as file:
        head = file.read(72)
    if path.suffix == ".ebmap" or (head.startswith(SQLITE) and head[68:] == MAP):
        raise ValueError(f"{path}: a map of ebjax; give it with --map to `python -m ebjax.slam`")
    if head.startswith(SQLITE):
        return "rtabmap" if path.suffix != ".db3" and not _is_rosbag(path) else "bag"
    if head.startswith((ROSBAG, MCAP, ZSTD)) or path.suffix in (".bag", *BAG_SUFFIXES):
        return "bag"
    return "rtabmap" if path.suffix == ".db" else "video"


def _folder_kind(path: Path) -> Literal["tum", "bag", "images"]:
    names = [child.name for child in path.iterdir()]
    if layout_reader(path) or any(name in ("camera.json", "odometry.txt") for name in names):
        return "tum"
    if "metadata.yaml" in names or any(name.endswith((".db3", ".mcap", ".db3.zstd", ".mcap.zstd")) for name in names):
        return "bag"
    pictures = (*SUFFIXES, *(f".{suffix}" for suffix in UNREAD))
    if not any(name.lower().endswith(pictures) for name in names):
        raise ValueError(folder_refusal(path))
    return "images"


def _is_rosbag(path: Path) -> bool:
    with contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as database:
        try:
            rows = database.execute("SELECT name FROM sqlite_master WHERE name IN ('topics', 'messages')").fetchall()
        except (sqlite3.Error, UnicodeDecodeError):  # damaged: its own reader says how
            rows = []
    return len(rows) == 2
