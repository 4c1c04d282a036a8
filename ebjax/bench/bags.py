"""Listing a large ROS bag of raw images and reading a frame; memory is compared with a small bag's.

Every listing is a process of its own, `python -m ebjax.logs BAG`, measured as the operating system counts it.
"""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ebjax.io.logs.bag_index import EXTRA
from ebjax.io.logs.open import open_log

WIDTH, HEIGHT, RATE_HZ = 1280, 720, 15
SMALL = 10
"""Images of the small bag."""


@dataclass(frozen=True)
class BagConfig:
    """Times listing a large ROS bag of raw images and reading a frame, and compares the memory with a small bag's."""

    size_gb: float = 4.0
    """Of the large bag, written into a temporary folder and removed."""
    kind: Literal["ros1", "mcap"] = "ros1"
    """Of bag."""
    frames: int = 30
    """How many are read, spread over the bag."""


def bench_bags(config: BagConfig) -> None:
    """Prints the times and the memory."""
    if not config.size_gb > 0 or config.frames < 1:
        raise ValueError("--size-gb must be above 0, --frames at least 1")
    print("\n".join(measured(config.size_gb, config.kind, config.frames).lines()))


@dataclass(frozen=True)
class Timing:
    """Of a large bag: seconds to list it, the median to read a frame, and the memory beyond a small bag's."""

    bytes: int
    images: int
    list_s: float
    small_list_s: float
    frame_s: float
    peak_mb: float
    small_peak_mb: float

    def lines(self) -> list[str]:
        """A line for each figure."""
        more = self.peak_mb - self.small_peak_mb
        return [
            f"bag    {self.bytes / 1e9:.2f} GB, {self.images} raw images of {WIDTH}x{HEIGHT}",
            f"list   {self.list_s:.2f} s; a bag of {SMALL} images {self.small_list_s:.2f} s",
            f"frame  {1e3 * self.frame_s:.1f} ms (median)",
            f"memory {self.peak_mb:.0f} MB, {more:.0f} MB more than the {self.small_peak_mb:.0f} MB of the small bag",
        ]


def measured(size_gb: float, kind: str, frames: int) -> Timing:
    """Writes a large and a small bag into a temporary folder, lists both, reads frames of the large one.

    Args:
      size_gb: of the large bag.
      kind: ros1 or mcap.
      frames: how many are read, spread over the bag.

    Raises:
      ValueError: rosbags is missing, or the disk has no room.
    """
    images = max(round(size_gb * 1e9 / (WIDTH * HEIGHT * 3)), 2)
    with tempfile.TemporaryDirectory(prefix="ebjax_bench_") as name:
        folder = Path(name)
        status = os.statvfs(folder)
        if status.f_bavail * status.f_frsize < 1.2e9 * size_gb:
            raise ValueError(f"{folder}: no room for {size_gb:g} GB; set TMPDIR to a larger disk, or --size-gb lower")
        small, large = (
            write_bag(folder / label, kind, count) for label, count in (("small", SMALL), ("large", images))
        )
        small_list_s, small_peak_mb = _listed(small)
        list_s, peak_mb = _listed(large)
        colour = open_log(large).colour
        times = []
        for index in np.linspace(0, len(colour) - 1, frames).astype(int).tolist():
            start = time.perf_counter()
            colour.decode(index)
            times.append(time.perf_counter() - start)
        size = sum(file.stat().st_size for file in [large, *large.rglob("*")] if file.is_file())
    return Timing(size, images, list_s, small_list_s, float(np.median(times)), peak_mb, small_peak_mb)


def write_bag(path: Path, kind: str, images: int) -> Path:
    """Writes a bag of raw images and odometry with rosbags; returns its path."""
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise ValueError(f"the bench writes its bags with rosbags: {EXTRA}") from None
    is_ros1 = kind == "ros1"
    path = path.with_suffix(".bag") if is_ros1 else path
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    writer: Any = rosbag1.Writer(path)
    if not is_ros1:
        writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    types, encode = store.types, store.serialize_ros1 if is_ros1 else store.serialize_cdr
    image_type, info_type = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
    rows = np.arange(HEIGHT * WIDTH * 3, dtype=np.int64).astype(np.uint8)
    focal, pixels = 900.0, rows
    region = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([focal, 0, WIDTH / 2, 0, focal, HEIGHT / 2, 0, 0, 1])
    p = np.insert(k, [3, 6, 9], 0.0)
    with writer:
        topics = [(f"/camera/{name}", kind) for name, kind in (("image_raw", image_type), ("camera_info", info_type))]
        image, info = (writer.add_connection(*topic, typestore=store) for topic in topics)
        for index in range(images):
            stamp_ns = 1_700_000_000_000_000_000 + index * 10**9 // RATE_HZ
            stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
            header = types["std_msgs/msg/Header"](*([index] if is_ros1 else []), stamp, "camera")
            message = types[image_type](header, HEIGHT, WIDTH, "rgb8", 0, WIDTH * 3, pixels)
            writer.write(image, stamp_ns, encode(message, image_type))
            values = (np.zeros(5), k, np.eye(3).ravel(), p, 0, 0, region)
            writer.write(
                info, stamp_ns, encode(types[info_type](header, HEIGHT, WIDTH, "plumb_bob", *values), info_type)
            )
    return path


def _listed(path: Path) -> tuple[float, float]:
    """Seconds and MB of listing a bag in a process of its own."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "ebjax.logs", str(path)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise ValueError(f"{path}: cannot be listed")
    return time.perf_counter() - start, usage.ru_maxrss / 1024
