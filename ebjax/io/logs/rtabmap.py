"""RTAB-Map's database (*.db, versions from 0.11.10 on) as a log. The file is never changed.

Odometry is Node.pose, as the robot measured it; RTAB-Map's own optimised poses are not used.
"""

import dataclasses
import sqlite3
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ebjax.io.calibration.calibration import Calibration
from ebjax.io.logs.log import Images, Log
from ebjax.io.logs.mount_options import MOUNT
from ebjax.io.logs.rtabmap_calibration import DatabaseCamera
from ebjax.io.logs.rtabmap_camera import calibration_from_camera, chosen_camera
from ebjax.io.logs.rtabmap_contents import contents_of
from ebjax.io.logs.rtabmap_database import NEWEST, check_version, reading
from ebjax.io.logs.rtabmap_depth import HEAD_BYTES, DepthHead, depth_head
from ebjax.io.logs.rtabmap_images import Strip, name_of, node_of, read_colour, read_depth, stored_colour
from ebjax.io.logs.rtabmap_movement import movement_notes, read_calibrations
from ebjax.io.logs.rtabmap_nodes import (
    INVALID,
    Node,
    chosen_session,
    in_time_order,
    read_nodes,
    sessions,
    skipped_notes,
    trajectory,
)

__all__ = ["node_of", "open_rtabmap"]

MISSING = {
    "camera": "the database holds no valid camera: give --camera FILE, any calibration of this camera",
    "mount": f"the database holds no local transform: {MOUNT}",
    "odometry": "no node has an odometry pose: the run is measured by the floor, --motion floor",
    "depth": "the database holds no depth images: the floor is metric without depth",
}


def _depth(database: sqlite3.Connection, nodes: Sequence[Node], stereo: bool) -> tuple[DepthHead | None, list[Node]]:
    """What the depth images are, and the nodes that have one; none where they are a stereo pair's right images."""
    found = [node for node in nodes if node.has_depth]
    if stereo or not found:
        return None, []
    query = f"SELECT substr(CAST(depth AS BLOB), 1, {HEAD_BYTES}) FROM Data WHERE id = ?"
    some = (found[0], found[len(found) // 2], found[-1])
    heads = [depth_head(head) for node in some for (head,) in database.execute(query, (node.id,)) if head]
    head = next(filter(None, heads), None)
    return head, found if head else []


def _used_camera(
    path: Path,
    calibrations: Sequence[tuple[tuple[DatabaseCamera, ...], int]],
    index: int | None,
    images: Literal["rectified", "raw"],
) -> tuple[Calibration | None, Strip, list[str]]:
    """The camera that is used, its part of the images, and notes: why this one, and whether it moves."""
    if not calibrations:
        if index:
            raise ValueError(f"{path}: no camera {index}; the database holds no calibration, leave camera_index out")
        return None, Strip(0, 1), []
    cameras = calibrations[0][0]
    chosen, notes = chosen_camera(path, cameras, index)
    camera, doubts = calibration_from_camera(path, cameras[chosen], images)
    alike = [(others[chosen], count) for others, count in calibrations if len(others) == len(cameras)]
    total = sum(count for _, count in calibrations)
    notes += doubts + movement_notes(path, cameras[chosen], alike, total)
    if odd := total - sum(count for _, count in alike):
        notes.append(f"{path}: {odd} of {total} nodes have not {len(cameras)} cameras side by side, as the others have")
    return camera, Strip(chosen, len(cameras), (cameras[chosen].width, cameras[chosen].height)), notes


def open_rtabmap(
    path: str | Path,
    *,
    session: int | None = None,
    camera_index: int | None = None,
    images: Literal["rectified", "raw"] = "rectified",
) -> Log:
    """Opens an RTAB-Map database for reading.

    Args:
      path: the .db file.
      session: the map_id to run; by default the one with most images.
      camera_index: of several cameras side by side; by default the one whose optical axis meets the floor nearest.
      images: how the stored images are understood: "rectified" takes P as RTAB-Map does, "raw" takes K and D.

    Raises:
      ValueError: not a database of RTAB-Map, damaged, of a version before 0.11.10, without an image, or without that
        session or camera; names the file.
    """
    path = Path(path)
    with reading(path) as database:
        version = check_version(database, path)
        every = read_nodes(database)
        words = ".".join(map(str, version))
        if not every:
            raise ValueError(f"{path}: of RTAB-Map {words}, has no nodes: nothing was recorded; give another database")
        chosen, notes = chosen_session(path, sessions(every), session)
        of_session = [node for node in every if node.session == chosen]
        valid, late = in_time_order(path, [node for node in of_session if node.weight > INVALID])
        frames = [node for node in valid if node.has_image and node.weight >= 0]
        if not frames:
            raise ValueError(
                f"{path}: of RTAB-Map {words}, session {chosen} has no image; record with Mem/BinDataKept=true"
            )
        calibrations = read_calibrations(database, path, frames, version)
        cameras = calibrations[0][0] if calibrations else ()
        head, deep = _depth(database, frames, any(camera.stereo for camera in cameras))
        contents = contents_of(database, version, every, cameras, head)
    if version[:2] > NEWEST:
        notes.append(f"{path}: of RTAB-Map {words}, newer than 0.23, the latest that was tried")
    notes += late + skipped_notes(path, of_session)

    camera, strip, why = _used_camera(path, calibrations, camera_index, images)
    notes += why
    if camera is not None and not camera.width:
        height, width = read_colour(path, frames[0].id, strip).shape[:2]
        camera = dataclasses.replace(camera, width=width, height=height)
    if not deep and any(node.has_depth for node in frames):
        notes.append(f"{path}: a stereo pair; the left images are used, the right ones are not depth")

    odometry = trajectory(path, valid, lambda node: node.pose)
    truth = trajectory(path, valid, lambda node: node.truth)
    lacks = {
        "camera": camera is None,
        "mount": camera is None or camera.base_from_camera is None,
        "odometry": odometry is None,
        "depth": not deep,
    }
    return Log(
        path=path,
        kind="RTAB-Map database",
        colour=_images(path, "image", frames, strip),
        depth=_images(path, "depth", deep, strip) if deep else None,
        camera=camera,
        odometry=odometry,
        truth=truth,
        notes=tuple(notes),
        contents=contents,
        missing={what: MISSING[what] for what, lacking in lacks.items() if lacking},
    )


def _images(path: Path, column: Literal["image", "depth"], nodes: Sequence[Node], strip: Strip) -> Images:
    ids = tuple(node.id for node in nodes)
    read = partial(read_colour if column == "image" else read_depth, path, strip=strip)
    whole = column == "image" and strip.count == 1
    return Images(
        source=f"{path}, Data.{column}",
        names=tuple(map(name_of, ids)),
        timestamps=np.array([node.stamp for node in nodes]),
        decode=lambda index: read(ids[index]),
        stored=(lambda index: stored_colour(path, ids[index])) if whole else None,
    )
