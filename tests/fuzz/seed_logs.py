"""Seeds that are logs: ROS bags of every kind, RTAB-Map databases, videos, folders of images and in TUM layout."""

import contextlib
import json
import sqlite3
import tempfile
from pathlib import Path

import cv2
import numpy as np

from ..io.logs import bag_writer, rtabmap_database
from .mutate import Input, input_from
from .seed_calibrations import EUROC
from .seed_images import depth_mm, jpeg_with_exif, png_of, written
from .seed_texts import CAMERA, tum_rows

SUFFIXES = {"ros1": (".bag",), "sqlite3": (".db3", ".zstd"), "mcap": (".mcap", ".zstd")}


def _bag(folder: Path, kind: str) -> Path:
    with bag_writer.BagWriter(folder, kind, name=kind) as bag:
        bag_writer.write_run(bag, count=3)
        colour = bag_writer.picture(3)
        for k in range(2):
            time = 1000.1 + 0.2 * k
            bag.compressed("/other/image/compressed", time, bag_writer.jpeg(colour), "jpeg", frame="other")
            packed = bag_writer.compressed_depth(np.full((24, 32), 1.5), "16UC1", "rvl")
            bag.compressed("/other/depth/compressedDepth", time, packed, "16UC1; compressedDepth rvl", frame="other")
            bag.tf(time, ("odom", "base_link", (k, 0, 0), (1, 0, 0, 0)))
            bag.pose_stamped("/truth", time, (k, 0.0, 0.0))
        bag.tf(1000, ("base_link", "imu_link", (0, 0, 0.1), (1, 0, 0, 0)), static=True)
        for k in range(8):
            bag.imu("/imu/data", 1000 + 0.1 * k, (np.cos(0.01 * k), 0, np.sin(0.01 * k), 0))
    return bag.path


def bags(*storages: str) -> list[Input]:
    """Bags of the kinds of `bag_writer` that begin so; of ROS 2, the folder and its file alone."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in bag_writer.KINDS:
            storage = kind.partition("-")[0]
            if storage in storages:
                path = _bag(Path(folder), kind)
                found.append(input_from(path))
                if path.is_dir():
                    (file,) = (file for file in path.iterdir() if file.suffix in SUFFIXES[storage])
                    found.append(input_from(file))
    return found


def databases() -> list[Input]:
    """RTAB-Map's: of today, with depth and closures, of two cameras, stereo, and of before 0.18."""
    make, mount = rtabmap_database, rtabmap_database.mount()
    model = make.model(p=np.array([[50.0, 0, 16, 0], [0, 52, 12, 0], [0, 0, 1, 0]]), base_from_camera=mount)
    deep = make.drive(3, depth=make.depth_rvl(make.depth_mm()))
    for node in deep:
        node.calibration, node.truth = model, node.pose
    floats = make.drive(3, depth=make.depth_float(np.full((24, 32), 1.5)))
    two = make.drive(2)
    for node in two:
        node.image, node.calibration = make.png(90, width=2 * make.WIDTH), model + model
    stereo = make.drive(2, depth=make.png(3))
    for node in stereo:
        node.calibration = make.stereo(model, model)
    old = make.drive(2)
    for node in old:
        node.calibration = make.old_model(mount)
    links = [make.Link(k, k + 1) for k in (1, 2)] + [make.Link(3, 1, kind=1)]
    sessions = deep + make.drive(2, first=9, session=1)
    made = (("deep", sessions, links, "0.23.8"), ("floats", floats, links, "0.21.4"), ("two", two, (), "0.20.0"))
    made += (("stereo", stereo, (), "0.19.3"), ("old", old, links, "0.11.10"))
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, nodes, between, version in made:
            path = make.make_database(Path(folder) / f"{name}.db", nodes, between, version)
            with contextlib.closing(sqlite3.connect(path)) as base:
                base.execute("UPDATE Node SET time_enter = '2024-05-06 07:08:09'")  # the same whenever it is made
                base.commit()
            found.append(input_from(path))
    return found


def videos() -> list[Input]:
    """Tiny ones: MP4 and AVI of OpenCV."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, codec in (("a.mp4", "mp4v"), ("a.avi", "MJPG"), ("b.avi", "mp4v")):
            path = Path(folder) / name
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 10, (64, 48))
            for k in range(6):
                writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
            writer.release()
            found.append(input_from(path))
    return found


def image_folders() -> list[Input]:
    timed = {f"{1000 + k}.5.png": png_of(32, 24) for k in range(3)}
    photographs = {f"img{k}.jpg": jpeg_with_exif(taken=f"2024:05:06 07:08:{k:02d}\0".encode()) for k in range(3)}
    others = {f"a{k}{suffix}": written(suffix, np.full((24, 32, 3), 9, np.uint8))
              for k, suffix in enumerate((".bmp", ".tiff", ".webp", ".png"))}  # fmt: skip
    return [Input(files, "") for files in (timed, photographs, others)]


def tum_folders() -> list[Input]:
    """With and without depth, odometry and ground truth; an association; the layouts of EuRoC and KITTI."""
    stamps = [f"{100 + 0.2 * k:.6f}" for k in range(4)]
    rgb = "# timestamp filename\n" + "".join(f"{stamp} rgb/{k}.png\n" for k, stamp in enumerate(stamps))
    depth = "".join(f"{stamp} depth/{k}.png\n" for k, stamp in enumerate(stamps))
    files = {"rgb.txt": rgb.encode(), "camera.json": json.dumps(CAMERA, indent=1).encode()}
    files |= {f"rgb/{k}.png": png_of(32, 24) for k in range(4)}
    more = {"depth.txt": depth.encode(), "odometry.txt": tum_rows(4).encode(), "groundtruth.txt": tum_rows(4).encode()}
    more |= {f"depth/{k}.png": written(".png", depth_mm()) for k in range(4)}
    lists = {name: content for name, content in (files | more).items() if name.endswith((".txt", ".json"))}
    both = "".join(f"{stamp} depth/{k}.png {stamp} rgb/{k}.png\n" for k, stamp in enumerate(stamps))
    associated = {name: content for name, content in (files | more).items() if name not in ("rgb.txt", "depth.txt")}
    associated["associations.txt"] = both.encode()
    every = (files | more, files, files | lists, lists, associated, _euroc(), _kitti())
    return [Input(content, "") for content in every]


def _euroc() -> dict[str, bytes]:
    rows = "".join(f"{10**18 + 10**8 * k},{k}.png\n" for k in range(4))
    files = {"mav0/cam0/data.csv": ("#timestamp [ns],filename\n" + rows).encode()}
    small = EUROC.replace("[640, 480]", "[32, 24]").replace("400, 410, 320, 240", "30, 30, 16, 12")
    files["mav0/cam0/sensor.yaml"] = small.encode()
    return files | {f"mav0/cam0/data/{k}.png": png_of(32, 24) for k in range(4)}


def _kitti() -> dict[str, bytes]:
    projection = "30 0 16 0 0 30 12 0 0 0 1 0"
    files = {"times.txt": b"0.0\n0.1\n0.2\n", "calib.txt": f"P0: {projection}\nP2: {projection}\n".encode()}
    return files | {f"image_2/{k:06d}.png": png_of(32, 24) for k in range(3)}
