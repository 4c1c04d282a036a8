"""A folder with a list of images as a log: rgb.txt of TUM, or another layout that `image_layouts` knows.

camera.json, depth.txt, odometry.txt and groundtruth.txt are read if there are any.
"""

from dataclasses import replace
from pathlib import Path

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.calibration.camera_json import calibration_from_camera
from ebjax.io.calibration.read import read_calibration
from ebjax.io.camera_file import read_camera
from ebjax.io.images import read_image
from ebjax.io.logs.depth_survey import depth_images
from ebjax.io.logs.image_layouts import Layout, layout_reader, located, there
from ebjax.io.logs.image_list import read_image_list
from ebjax.io.logs.image_survey import LOOKED_AT, file_images, spread, survey
from ebjax.io.logs.kitti_calibration import read_kitti_calibration
from ebjax.io.logs.lacking import OPTIONAL, folder_refusal
from ebjax.io.logs.log import Images, Log
from ebjax.io.logs.mount_options import MOUNT
from ebjax.io.trajectory import Trajectory, read_tum

MISSING = {
    "camera": "there is no camera.json: write one, or give --camera FILE, any calibration of this camera",
    "mount": MOUNT,
    "odometry": "there is no odometry.txt: the run is measured by the floor alone, or give " + OPTIONAL["odometry.txt"],
    "depth": f"there is no depth.txt: the floor is metric without depth, or give {OPTIONAL['depth.txt']}",
}


def open_tum_folder(path: str | Path, *, depth: bool = True, depth_scale: float | None = None) -> Log:
    """Opens a folder with a list of images; text files that are gzipped (.gz) are read too.

    Args:
      path: the folder.
      depth: whether to look for depth.txt.
      depth_scale: depth file units per metre; None: as camera.json says.

    Raises:
      ValueError: no such folder, no list of images, none of them there, or a malformed file; names the file, the line
        or key, and the remedy.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; a sequence is a folder with rgb.txt and camera.json")
    if (read_layout := layout_reader(folder)) is None:
        raise ValueError(folder_refusal(folder))
    layout = read_layout()
    notes = list(layout.notes)
    colour = _colour(layout)
    deep = depth and (layout.depth is not None or there(folder / "depth.txt"))
    camera = None
    if there(folder / "camera.json"):
        own = read_camera(folder / "camera.json", depth=deep and depth_scale is None)
        depth_scale = depth_scale or own.depth_scale
        camera = calibration_from_camera(folder / "camera.json", own, own.depth_scale)
    elif layout.calibration is not None and colour.size is not None:
        camera = _calibration(layout.calibration, colour.size)
    if deep and depth_scale is None:
        deep = False
        notes.append(f"{folder / 'depth.txt'}: left out, as no camera.json says how many units a metre has")
    depths = None
    if deep and depth_scale is not None:
        depths = _depth(folder, layout, depth_scale, colour)
        notes += depths.notes
    odometry, truth = (_poses(folder / f"{name}.txt") for name in ("odometry", "groundtruth"))
    notes += [note for poses in (odometry, truth) if poses is not None for note in poses.notes]
    lacks = {
        "camera": camera is None,
        "mount": camera is not None and camera.base_from_camera is None,
        "odometry": odometry is None,
        "depth": depths is None,
    }
    return Log(
        path=folder,
        kind=layout.kind,
        colour=colour,
        depth=depths,
        camera=camera,
        odometry=odometry,
        truth=truth,
        notes=tuple(notes),
        contents=_contents(layout, colour, depths, odometry, truth),
        missing={what: sentence for what, sentence in MISSING.items() if lacks[what]},
    )


def _colour(layout: Layout) -> Images:
    listed = layout.colour
    if not listed.names:
        return Images(str(listed.path), (), listed.timestamps, lambda k: read_image(layout.files[k]))
    found = survey(str(listed.path), [layout.files[row] for row in spread(len(layout.files), LOOKED_AT)])
    images = file_images(str(listed.path), listed.names, layout.files, listed.timestamps, found)
    return replace(images, notes=(*found.notes, *images.notes))


def _depth(folder: Path, layout: Layout, depth_scale: float, colour: Images) -> Images:
    """Those of depth.txt, or of the association."""
    if there(folder / "depth.txt"):
        listed = read_image_list(folder / "depth.txt")
        files, moved = located(folder, listed)
        notes = (*listed.notes, *moved)
    else:
        assert layout.depth is not None
        listed, files, notes = layout.depth, layout.depth_files, layout.depth.notes
    return depth_images(listed, files, notes, depth_scale, colour.sizes)


def _calibration(path: Path, size: tuple[int, int]) -> Calibration:
    """The calibration that a layout keeps beside its images, of their (width, height) where it says none."""
    if path.name == "calib.txt":
        return read_kitti_calibration(path, size)
    return read_calibration(path, size=size)


def _poses(path: Path) -> Trajectory | None:
    return read_tum(path) if there(path) else None


def _contents(
    layout: Layout, colour: Images, depth: Images | None, odometry: Trajectory | None, truth: Trajectory | None
) -> tuple[str, ...]:
    lines = [f"{layout.colour.path.name}: {len(colour)} images"]
    lines += [f"{Path(depth.source).name}: {len(depth)} depth images"] if depth is not None else []
    for trajectory in (odometry, truth):
        if trajectory is not None:
            lines.append(f"{Path(trajectory.path).name}: {len(trajectory.poses)} poses")
    return tuple(lines)
