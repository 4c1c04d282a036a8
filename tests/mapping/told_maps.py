"""Small maps whose sessions drive out and back, with everything that is exported known beforehand."""

import cv2
import numpy as np

from ebjax.geometry.camera import Camera, FloorView
from ebjax.geometry.planar import between
from ebjax.io.map_file.rows import EdgeRow, FrameRow, KeyframeRow
from ebjax.mapping.looked_by import NAME, looked_by_arrays
from ebjax.views.run_view import from_camera

PITCH = np.radians(40.0)
MOUNT = np.array(
    [
        [0.0, -np.sin(PITCH), np.cos(PITCH), 0.2],
        [-1.0, 0.0, 0.0, 0.0],
        [0.0, -np.cos(PITCH), -np.sin(PITCH), 0.6],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
AHEAD = np.array([0.02, 0.0, 0.01])
"""A frame between keyframes, from the keyframe before."""


def looked_by_of(forward_m=0.0):
    """State of a session whose camera stands so much further ahead."""
    mount = MOUNT.copy()
    mount[0, 3] += forward_m
    camera = Camera(K, mount, 320, 240)
    floor = FloorView(0.5 + forward_m, 1.1 + forward_m, -0.3, 0.3, 0.02)
    return looked_by_arrays(camera, from_camera(camera, floor))


def way(count):
    """Out along x and back beside it."""
    out = np.arange(count // 2)
    there = np.stack([0.2 * out, 0.0 * out, 0.0 * out], 1)
    back = np.stack([0.2 * out[::-1], 0.0 * out + 0.1, 0.0 * out + np.pi], 1)
    return np.concatenate([there, back])


def arrays_of(range_m=1.0, standing=False, view=True):
    """A grey floor view; with an obstacle on its upper right quarter."""
    image, floor = np.full((30, 30, 3), 128, np.uint8), np.full((30, 30), 255, np.uint8)
    if standing:
        floor[:12, 18:] = 0
    arrays = {
        "floor": cv2.imencode(".png", floor)[1].ravel(),
        "features.range_m": np.full(5, range_m, np.float32),
    }
    return arrays | ({"view": cv2.imencode(".jpg", image)[1].ravel()} if view else {})


def add_session(kept, log, count=8, names="rgb/{:03d}.png", state=None, finish=True, facts=None, **arrays):
    """Drives the way once more, with a kept and a refused closure, and a frame behind every keyframe."""
    known = kept.keyframes()
    first = int(known.id[-1]) + 1 if len(known) else 0
    edge = 1000 * first
    session = kept.begin_session(str(log), facts or {})
    kept.put_state(session, NAME, looked_by_of() if state is None else state)
    poses = way(count)
    for k, pose in enumerate(poses):
        edges = []
        if k:
            step = between(pose, poses[k - 1])
            edges.append(EdgeRow(edge + 3 * k, "step", first + k, first + k - 1, False, True, "used", step, np.eye(3)))
        if k == count - 1:
            for j in (0, 1):
                closure = first + k, first + j, True, not j, "few matches" if j else "kept", between(pose, poses[j])
                edges.append(EdgeRow(edge + 3 * k + 1 + j, "closure", *closure, 0.01 * np.eye(3), 30, 40, 0.5))
        row = KeyframeRow(first + k, session, 2 * k, 100.0 * session + k, names.format(2 * k), pose)
        between_row = FrameRow(2 * k + 1, 100.0 * session + k + 0.5, names.format(2 * k + 1), first + k, AHEAD)
        kept.append(row, arrays_of(**arrays), [(one, {}) for one in edges], [between_row])
    if finish:
        kept.end_session(session)
    return session
