"""What is in a log, as plain values by name. A few images are decoded at most, for their size."""

from pathlib import Path
from typing import Any

import numpy as np

from ebjax.io.camera_file import CameraFile
from ebjax.io.logs.bag import open_files
from ebjax.io.logs.camera import calibration_of, mounted
from ebjax.io.logs.lacking import lacks
from ebjax.io.logs.log import Log
from ebjax.io.logs.mount_options import NOTHING, MountOptions
from ebjax.io.sequence import read_sequence
from ebjax.logs.part_facts import Facts, camera_facts, depth_facts, image_facts, mount_facts, pose_facts, time_facts

ONE_IMAGE = "one image only; a run needs at least two"


def log_facts(
    log: Log,
    camera_file: Path | None = None,
    mount: MountOptions = NOTHING,
    max_time_difference_s: float = 0.02,
) -> Facts:
    """All that is to be said of a log.

    Args:
      log: opened.
      camera_file: a calibration to use in place of the log's.
      mount: where the user says that the camera sits.
      max_time_difference_s: how far apart in time an image may be from its depth image or nearest pose.

    Raises:
      ValueError: the calibration file or the mount cannot be used; names it.
    """
    stamps, close = log.colour.timestamps, max_time_difference_s
    camera = calibration_of(log, camera_file, mount)
    log = log if camera is None else log.fitting((camera.width, camera.height))
    pose = mount.pose(log.base_from_camera) if camera is None else camera.base_from_camera
    notes, refused = () if camera is None else camera.notes, None if len(stamps) > 1 else ONE_IMAGE
    if camera is not None and pose is not None:
        said, refused = _tried(log, mounted(camera), close)
        notes += said
    facts = {
        "kind": log.kind,
        "images": image_facts(log.colour),
        "depth": None if log.depth is None else depth_facts(log.depth, stamps, close),
        "camera": None if camera is None else camera_facts(camera),
        "mount": None if pose is None else mount_facts(pose),
        "odometry": None if log.odometry is None else pose_facts(log.odometry, stamps, close),
        "truth": None if log.truth is None else pose_facts(log.truth, stamps, close),
        "contents": list(log.contents),
        "notes": list(dict.fromkeys((*log.notes, *log.colour.notes, *notes))),
        "missing": lacks(log, camera is None, pose is None, mount),
        "refused": refused,
        "ready": camera is not None and pose is not None and refused is None,
    }
    return {"path": str(log.path), **_without_path(facts, log.path)}


def bag_facts(path: Path) -> Facts:
    """What can be said of a bag without images: kind, span, topics, and what was cut off.

    Raises:
      ValueError: not a bag; names it.
    """
    bag = open_files(path)
    times = time_facts(np.sort(bag.time_ns) * 1e-9)
    messages = {"count": len(bag.time_ns), "first_s": times["first_s"], "span_s": times["span_s"]}
    facts = {"kind": bag.kind, "messages": messages, "contents": list(bag.contents()), "notes": list(bag.notes)}
    return {"path": str(path), **_without_path(facts, path)}


def _tried(log: Log, camera: CameraFile, max_time_difference_s: float) -> tuple[tuple[str, ...], str | None]:
    """What reading the run says beyond what is missing, and why it cannot be read."""
    try:
        sequence = read_sequence(log, camera=camera, max_time_difference_s=max_time_difference_s)
    except ValueError as fault:
        return (), str(fault)
    missing = {f"{log.path}: {sentence}" for sentence in log.missing.values()}
    return tuple(note for note in sequence.notes if note not in missing), None


def _without_path(value: Any, path: Path) -> Any:
    """The same values, with the log's path, that is said once, taken out of every sentence."""
    if isinstance(value, dict):
        return {key: _without_path(one, path) for key, one in value.items()}
    if isinstance(value, list):
        return [_without_path(one, path) for one in value]
    if not isinstance(value, str):
        return value
    if value == str(path):
        return ""
    for words in (f" of {path}", f"{path}: ", f"{path}, ", f"{path}/"):
        value = value.replace(words, "")
    return value
