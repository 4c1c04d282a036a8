"""A camera from its CameraInfo messages."""

import dataclasses
from collections import Counter
from collections.abc import Sequence

import numpy as np

from ebjax.geometry.lens_models import lens_fault
from ebjax.io.calibration.calibration import Calibration, implausible
from ebjax.io.logs.ros_message import CameraInfo

LENSES = {
    "": "plumb_bob",
    "none": "plumb_bob",
    "pinhole": "plumb_bob",
    "brown_conrady": "plumb_bob",
    "modified_brown_conrady": "plumb_bob",
    "inverse_brown_conrady": "plumb_bob",
    "radtan": "plumb_bob",
    "fisheye": "equidistant",
    "kannala_brandt4": "equidistant",
}


def is_empty(info: CameraInfo) -> bool:
    """Tells whether a CameraInfo says nothing: no focal length, or no size."""
    return max(info.K[0], info.P[0]) <= 0 or not info.width or not info.height


def _values(info: CameraInfo) -> tuple:
    return info.width, info.height, info.model, info.D, info.K, info.P, info.binning, info.roi


def _windowed(K: np.ndarray, info: CameraInfo) -> tuple[np.ndarray, int, int]:
    """K and the size of the images as they are sent: cut to the region of interest, then binned."""
    x, y, width, height = info.roi
    width, height = width or info.width, height or info.height
    across, down = max(info.binning[0], 1), max(info.binning[1], 1)
    move = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
    bins = np.array([[1 / across, 0.0, 0.5 / across - 0.5], [0.0, 1 / down, 0.5 / down - 0.5], [0.0, 0.0, 1.0]])
    return bins @ move @ K, width // across, height // down


def _lens(info: CameraInfo, topic: str) -> tuple[str, tuple[float, ...], list[str]]:
    model = LENSES.get(info.model.strip().lower(), info.model.strip().lower())
    if model in ("plumb_bob", "rational_polynomial") and not any(info.D):
        return "pinhole", (), []
    notes = []
    if model != info.model:
        notes.append(f"{topic}: its lens {info.model!r} is taken as {model}; check the straightness of lines")
    if fault := lens_fault(model, info.D):
        raise ValueError(f"{topic}: {fault}; give --camera FILE")
    return model, info.D, notes


def calibration_from(
    infos: Sequence[tuple[CameraInfo, int]], topic: str, source: str, image_topic: str
) -> Calibration | None:
    """The camera of an image topic; None where no message has values.

    Rectified images (their topic is named image_rect...) go with P and no distortion; others with K and D.

    Args:
      infos: the topic's different messages, and how often each occurs.
      topic: theirs.
      source: for messages.
      image_topic: the images'.

    Raises:
      ValueError: an unknown lens, or values that no camera has; names the topic.
    """
    kinds = Counter[tuple]()
    for info, count in infos:
        kinds[_values(info)] += 0 if is_empty(info) else count
    kinds += Counter()
    if not kinds:
        return None
    most = kinds.most_common(1)[0][0]
    info = next(info for info, _ in infos if _values(info) == most)
    notes = []
    if len(kinds) > 1:
        notes.append(f"{topic}: {len(kinds)} different cameras over the log; the most frequent one is used")
    is_rectified = "image_rect" in image_topic
    if (is_rectified and info.P[0] > 0) or info.K[0] <= 0:
        full, model, coefficients = np.array(info.P).reshape(3, 4)[:, :3], "pinhole", tuple[float, ...]()
        if not is_rectified and any(info.D):
            notes.append(f"{topic}: K is empty, so P is used; the images are taken as rectified")
    else:
        full = np.array(info.K).reshape(3, 3)
        model, coefficients, said = ("pinhole", (), []) if is_rectified else _lens(info, topic)
        notes += said
    whole = Calibration(
        source=source,
        kind="ROS CameraInfo",
        width=info.width,
        height=info.height,
        intrinsics=full,
        distortion_model=model,
        distortion=coefficients,
        notes=tuple(notes),
    )
    if fault := implausible(whole, cut=True):
        raise ValueError(f"{topic}: {fault}, or give --camera FILE")
    intrinsics, width, height = _windowed(full, info)
    if min(width, height) < 1:
        raise ValueError(f"{topic}: its binning and region leave no pixel of the image; give --camera FILE")
    return dataclasses.replace(whole, width=width, height=height, intrinsics=intrinsics)
