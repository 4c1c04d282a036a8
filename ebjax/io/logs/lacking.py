"""What a log lacks to be run, all of it in one sentence, with an example of every file that gives it."""

import contextlib
import json
from itertools import chain
from pathlib import Path

import numpy as np

from ebjax.geometry.mount_numbers import pose_of
from ebjax.io.camera_file import read_camera
from ebjax.io.image_folder import SUFFIXES, natural
from ebjax.io.image_header import read_header
from ebjax.io.logs.image_layouts import there
from ebjax.io.logs.log import Log
from ebjax.io.logs.mount_options import MOUNT, NOTHING, MountOptions
from ebjax.io.logs.photograph_times import times_in_names

READ = (
    "a TUM folder (rgb.txt, camera.json), a .bag, .db3, .mcap or their folder, an RTAB-Map .db, a video, or a folder "
    "of images"
)
SIZE = (640, 480)
"""Width and height in an example, px, where no image tells them."""
OPTIONAL = {
    "odometry.txt": "rows of poses of base_link, `timestamp tx ty tz qx qy qz qw`, as `0.000000 0 0 0 0 0 0 1`",
    "depth.txt": "lines of depth images, `timestamp file`, as `0.000000 depth/0.png`",
}


def camera_example(size: tuple[int, int] = SIZE) -> str:
    """A camera.json on one line: a pinhole 0.4 m above the floor that looks down by 30 degrees."""
    width, height = size
    pose = pose_of(np.array([np.pi / 6, 0.0, 0.0, 0.4, 0.0, 0.0])).round(6)
    rows = [[int(value) if value == int(value) else value for value in row] for row in pose.tolist()]
    values = {"width": width, "height": height, "fx": width, "fy": width, "cx": (width - 1) / 2, "cy": (height - 1) / 2}
    return json.dumps({**values, "depth_scale": 1000, "T_base_camera": rows})


def camera_in_words(size: tuple[int, int] = SIZE) -> str:
    """What camera.json is, with an example."""
    return f"`{camera_example(size)}` with your camera's numbers (px; T_base_camera: p_base = T p_camera, m)"


def lacks(log: Log, camera: bool, mount: bool, given: MountOptions = NOTHING) -> dict[str, str]:
    """For each of "camera", "mount", "odometry" and "depth" that is not there, how to give it.

    Args:
      log: opened.
      camera: whether there is none.
      mount: whether nothing says how it is mounted.
      given: what the user says of that.
    """
    said = {}
    if camera:
        sentence = log.missing.get("camera", "give --camera FILE, any calibration of it")
        said["camera"] = f"{sentence}; camera.json is such a file: {camera_in_words((log.colour.sizes or (SIZE,))[0])}"
    if mount:
        said["mount"] = log.missing.get("mount", MOUNT) if given == NOTHING else MOUNT
    return said | {what: log.missing[what] for what in ("odometry", "depth") if what in log.missing}


def refusal(log: Log, given: MountOptions = NOTHING) -> str:
    """Why a log without a camera is not run: what must be given, numbered where it is more than one thing."""
    mount = given.file is None and given.pose(log.base_from_camera) is None
    found = lacks(log, True, mount, given)
    if "mount" not in found:
        return f"{log.path}: {found['camera']}"
    return (
        f"{log.path}: two things are missing: (1) the camera: {found['camera']}. (2) the mount, where that file does "
        f"not say it: {found['mount']}"
    )


def folder_refusal(folder: Path) -> str:
    """Why a folder without a list of images is not run: every file that it lacks, each with an example."""
    images = _images(folder)
    needed = [] if images else ["two images at least, JPEG or PNG"]
    needed.append(
        f"rgb.txt, a line for every image, `timestamp file` (s, increasing), as `{_first_line(folder, images)}`"
    )
    header = read_header(images[0]) if images else None
    example = camera_in_words(SIZE if header is None else header.size)
    if not there(folder / "camera.json"):
        needed.append(f"camera.json, as {example}, or any calibration with --camera FILE")
    elif fault := _camera_fault(folder):
        needed.append(f"a camera.json that can be read ({fault}), as {example}")
    lines = needed[0] if len(needed) == 1 else "; ".join(f"({k}) {one}" for k, one in enumerate(needed, start=1))
    said = f"{folder}: it lacks {lines}."
    if absent := [f"{name} ({form})" for name, form in OPTIONAL.items() if not there(folder / name)]:
        said += f" It runs without {' and '.join(absent)}."
    if not images:
        return f"{said} Or give {READ}"
    if images[0].parent != folder:
        return f"{said} Or give {images[0].parent}, a folder of images"
    return (
        f"{said} Or move camera.json and odometry.txt out of it and give --camera FILE: it is then a folder of images, "
        "with the times of their names, of EXIF, or of --frames-per-s"
    )


def _first_line(folder: Path, images: list[Path]) -> str:
    """The first line of rgb.txt: the first image, at the time in its name where the names tell times, else at 0."""
    if not images:
        return "0.000000 rgb/0.png"
    with contextlib.suppress(ValueError):  # two of one time
        if named := times_in_names(folder, images):
            return f"{named[1][0]:.6f} {named[0][0].relative_to(folder)}"
    return f"{0:.6f} {images[0].relative_to(folder)}"


def _camera_fault(folder: Path) -> str:
    """What is wrong with a folder's camera.json; empty where nothing is."""
    try:
        read_camera(folder / "camera.json", depth=there(folder / "depth.txt"))
    except (ValueError, OSError) as fault:
        return str(fault)
    return ""


def _images(folder: Path) -> list[Path]:
    """The images of a folder, or of the first folder in it that has some and is not named depth; in natural order."""
    inside = sorted(one for one in folder.iterdir() if one.is_dir() and not one.name.startswith("."))
    for place in chain([folder], inside):
        found = [one for one in place.iterdir() if one.suffix.lower() in SUFFIXES and not one.name.startswith(".")]
        if found and (place == folder or "depth" not in place.name.lower()):
            return sorted(found, key=natural)
    return []
