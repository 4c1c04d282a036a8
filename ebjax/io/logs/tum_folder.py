"""A folder in TUM layout as a log: rgb.txt; camera.json, depth.txt, odometry.txt, groundtruth.txt if there are any."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from ebjax.io.calibration.camera_json import calibration_from_camera
from ebjax.io.camera_file import read_camera
from ebjax.io.images import read_depth, read_image
from ebjax.io.logs.log import Images, Log
from ebjax.io.text import check_increasing, data_lines, floats
from ebjax.io.trajectory import Trajectory, read_tum

MISSING = {
    "camera": "there is no camera.json: write one, or give --camera FILE, any calibration of this camera",
    "odometry": "there is no odometry.txt: the run is measured by the floor alone, or give rows `timestamp tx ty tz qx "
    "qy qz qw`, the pose of base_link in the odometry's frame",
    "depth": "there is no depth.txt: the floor is metric without depth",
}


def open_tum_folder(path: str | Path, *, depth: bool = True, depth_scale: float | None = None) -> Log:
    """Opens a folder in TUM layout; files that are gzipped (.gz) are read too.

    Args:
      path: the folder.
      depth: whether to look for depth.txt.
      depth_scale: depth file units per metre; None: as camera.json says.

    Raises:
      ValueError: no such folder, no rgb.txt, or a malformed file; names the file, the line or key, and the remedy.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; a sequence is a folder with rgb.txt and camera.json")
    if not (folder / "rgb.txt").is_file():
        raise ValueError(f"{folder / 'rgb.txt'}: no such file; a sequence needs rgb.txt and camera.json")
    notes, deep = [], depth and _there(folder / "depth.txt")
    camera = None
    if _there(folder / "camera.json"):
        camera = read_camera(folder / "camera.json", depth=deep and depth_scale is None)
        depth_scale = depth_scale or camera.depth_scale
    if deep and depth_scale is None:
        deep = False
        notes.append(f"{folder / 'depth.txt'}: left out, as no camera.json says how many units a metre has")
    names, stamps = _read_list(folder / "rgb.txt")
    colour = Images(
        source=str(folder / "rgb.txt"),
        names=names,
        timestamps=stamps,
        decode=lambda k: read_image(folder / names[k]),
        files=tuple(folder / name for name in names),
    )
    depths = _depth(folder, depth_scale) if deep and depth_scale is not None else None
    odometry, truth = (_poses(folder / f"{name}.txt") for name in ("odometry", "groundtruth"))
    lacks = {"camera": camera is None, "odometry": odometry is None, "depth": depths is None}
    return Log(
        path=folder,
        kind="folder in TUM layout",
        colour=colour,
        depth=depths,
        camera=None if camera is None else calibration_from_camera(folder / "camera.json", camera, camera.depth_scale),
        odometry=odometry,
        truth=truth,
        notes=tuple(notes),
        contents=_contents(colour, depths, odometry, truth),
        missing={what: sentence for what, sentence in MISSING.items() if lacks[what]},
    )


def _depth(folder: Path, depth_scale: float) -> Images:
    names, stamps = _read_list(folder / "depth.txt")
    return Images(str(folder / "depth.txt"), names, stamps, lambda k: read_depth(folder / names[k], depth_scale))


def _poses(path: Path) -> Trajectory | None:
    return read_tum(path) if _there(path) else None


def _contents(
    colour: Images, depth: Images | None, odometry: Trajectory | None, truth: Trajectory | None
) -> tuple[str, ...]:
    lines = [f"rgb.txt: {len(colour)} images"]
    lines += [f"depth.txt: {len(depth)} depth images"] if depth is not None else []
    for trajectory in (odometry, truth):
        if trajectory is not None:
            lines.append(f"{Path(trajectory.path).name}: {len(trajectory.poses)} poses")
    return tuple(lines)


def _there(path: Path) -> bool:
    return path.is_file() or Path(f"{path}.gz").is_file()


def _read_list(path: Path) -> tuple[tuple[str, ...], Float[np.ndarray, " N"]]:
    names, stamps = [], []
    for number, line in data_lines(path):
        fields = line.split(maxsplit=1)
        if len(fields) != 2:
            raise ValueError(f"{path} line {number}: {line!r} is not `timestamp file`; correct or remove the line")
        names.append(fields[1])
        stamps.append((number, floats(path, number, fields[:1])[0]))
    check_increasing(path, stamps)
    return tuple(names), np.array([stamp for _, stamp in stamps], dtype=np.float64)
