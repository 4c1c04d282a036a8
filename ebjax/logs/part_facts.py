"""What is to be said of the parts of a log, as plain values by name: images, depth, camera, mount, poses."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.geometry.mount_numbers import mount_of
from ebjax.io.calibration.calibration import Calibration
from ebjax.io.images import BrokenFrame
from ebjax.io.logs.log import Images
from ebjax.io.timed_poses import nearest, poses_at
from ebjax.io.trajectory import Trajectory
from ebjax.logs.field_of_view import field_of_view_deg

Facts = dict[str, Any]
TRIES = 3


def time_facts(stamps: Float[np.ndarray, " N"]) -> Facts:
    """First time, span, median rate and largest gap; None where there are too few times."""
    gaps = np.diff(stamps)
    median = float(np.median(gaps)) if len(gaps) else 0.0
    return {
        "first_s": float(stamps[0]) if len(stamps) else None,
        "span_s": float(stamps[-1] - stamps[0]) if len(stamps) else None,
        "rate_hz": 1 / median if median > 0 else None,
        "largest_gap_s": float(gaps.max()) if len(gaps) else None,
    }


def image_facts(images: Images) -> Facts:
    """Count, size, and times. One image is decoded; up to three where the first are broken, and `broken` says why."""
    shape, broken = None, None
    for index in range(min(TRIES, len(images))):
        try:
            shape = images.decode(index).shape
            break
        except BrokenFrame as fault:
            broken = broken or str(fault)
    return {
        "source": images.source,
        "count": len(images),
        "width": shape and shape[1],
        "height": shape and shape[0],
        **time_facts(images.timestamps),
        "broken": broken,
    }


def depth_facts(depth: Images, stamps: Float[np.ndarray, " N"], max_time_difference_s: float) -> Facts:
    """As of images, and how many colour images have a depth image near in time."""
    apart = np.abs(depth.timestamps[nearest(depth.timestamps, stamps)] - stamps) if len(depth) else np.zeros(0)
    return image_facts(depth) | {"paired": int((apart <= max_time_difference_s).sum()), "images": len(stamps)}


def camera_facts(camera: Calibration) -> Facts:
    """Size, focal lengths, centre, lens, and how wide it sees."""
    k = camera.intrinsics
    return {
        "source": camera.source,
        "kind": camera.kind,
        "width": camera.width,
        "height": camera.height,
        "fx": float(k[0, 0]),
        "fy": float(k[1, 1]),
        "cx": float(k[0, 2]),
        "cy": float(k[1, 2]),
        "distortion_model": camera.distortion_model,
        "D": list(camera.distortion),
        "field_of_view_deg": list(field_of_view_deg(camera)),
    }


def mount_facts(base_from_camera: Float[np.ndarray, "4 4"]) -> Facts:
    """The six numbers of the mount, named as the flags of --mount."""
    pitch, roll, yaw, height, x, y = mount_of(base_from_camera).tolist()
    angles = {"pitch_deg": pitch, "roll_deg": roll, "yaw_deg": yaw}
    return {"height_m": height, **{name: float(np.rad2deg(a)) for name, a in angles.items()}, "x_m": x, "y_m": y}


def pose_facts(poses: Trajectory, stamps: Float[np.ndarray, " N"], max_time_difference_s: float) -> Facts:
    """Count, times, distance driven, how many images have a pose, and how far ahead its clock is, if none can have."""
    first, last = poses.timestamps[0], poses.timestamps[-1]
    apart = len(stamps) > 0 and bool(first > stamps[-1] or last < stamps[0])
    return {
        "source": poses.path,
        "count": len(poses.poses),
        **time_facts(poses.timestamps),
        "distance_m": float(np.linalg.norm(np.diff(poses.poses[:, :2, 3], axis=0), axis=1).sum()),
        "covered": int(poses_at(poses, stamps, max_time_difference_s)[1].sum()),
        "images": len(stamps),
        "clock_ahead_s": float(first - stamps[0]) if apart else None,
    }
