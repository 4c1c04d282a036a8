"""Pairs of images for table 3, cut from a run where the robots truly face each other over the same floor."""

import numpy as np
from jaxtyping import Float, Int

from ebjax.evaluation.run import spread_rows
from ebjax.features.table import Pair
from ebjax.geometry.camera import Camera, image_from_floor, raw_from_ideal
from ebjax.geometry.homography import apply
from ebjax.geometry.planar import between, matrix
from ebjax.paper.run import Run

NEAR_M = 0.3
"""Largest distance of the floor patches' centres."""
FACING_RAD = np.radians(15.0)
INSIDE_PX = 2.0
REACH = 1.5
"""Length of the patch over its width at the near edge."""


def floor_quad(camera: Camera, near_m: float, far_m: float) -> Float[np.ndarray, "4 2"]:
    """A rectangle of floor whose corners the image shows, (x, y) px: far left, far right, near right, near left.

    It begins at the nearest floor that is seen, is as wide as the image is there, less a tenth, and REACH times as long
    as wide where the view reaches so far.

    Args:
      camera: over the floor z = 0 of base.
      near_m: nearest floor of the view, ahead of base.
      far_m: the farthest.
    """
    homography = np.asarray(image_from_floor(camera), np.float64)
    near = near_m + 0.02 * (far_m - near_m)
    left, right = (_reach(homography, camera, near, side) for side in (1.0, -1.0))
    half = 0.9 * min(left, right)
    far = min(far_m, near + REACH * 2 * half)
    corners = np.array([[far, half], [far, -half], [near, -half], [near, half]])
    return np.asarray(raw_from_ideal(camera, apply(homography, corners)))


def _reach(homography: np.ndarray, camera: Camera, x: float, side: float) -> float:
    """How far to a side the image shows the floor at a distance."""
    y = side * np.linspace(0.01, 3.0, 600)
    pixels = np.asarray(raw_from_ideal(camera, apply(homography, np.stack([np.full_like(y, x), y], 1))))
    limit = np.array([camera.width - 1, camera.height - 1]) - INSIDE_PX
    seen = ((pixels >= INSIDE_PX) & (pixels <= limit[None, :])).all(1)
    return float(abs(y[max(int(np.argmin(np.append(seen, False))) - 1, 0)]))


def facing_frames(run: Run, centre_m: Float[np.ndarray, "2"], count: int) -> Int[np.ndarray, "M 2"]:
    """(frame of the way out, frame of the way back) that look at the same floor by the truth, spread along the path."""
    truth = run.truth
    c, s = np.cos(truth[:, 2]), np.sin(truth[:, 2])
    centres = truth[:, :2] + np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], 1) @ centre_m
    apart = np.linalg.norm(centres[run.back][:, None] - centres[run.out][None, :], axis=-1)
    turn = truth[run.back, 2][:, None] - truth[run.out, 2][None, :] - np.pi
    apart = np.where(np.abs(np.arctan2(np.sin(turn), np.cos(turn))) <= FACING_RAD, apart, np.inf)
    rows = np.flatnonzero(apart.min(1) <= NEAR_M)
    rows = spread_rows(rows, count + 2)[1:-1] if len(rows) >= count + 2 else spread_rows(rows, count)
    return np.stack([run.out[apart[rows].argmin(1)], run.back[rows]], 1)


def cut_pairs(run: Run, name: str, count: int) -> list[Pair]:
    """At most `count` pairs of a run with the homography of the floor between them, from the truth."""
    x = np.asarray(apply(np.asarray(run.view.floor_from_view), np.array([[0.0, 0.0], [0.0, run.view.size[0] - 1.0]])))
    quad = floor_quad(run.camera, float(x[:, 0].min()), float(x[:, 0].max()))
    image = np.asarray(image_from_floor(run.camera), np.float64)
    centre = np.asarray(apply(np.linalg.inv(image), quad)).mean(0)
    made = []
    for k, (a, b) in enumerate(facing_frames(run, centre, count)):
        b_from_a = matrix(between(run.truth[b], run.truth[a]))
        homography = image @ b_from_a @ np.linalg.inv(image)
        first, second = run.sequence.rgb(int(a)), run.sequence.rgb(int(b))
        made.append(Pair(f"{name} {k + 1}", first, second, quad, homography))
    return made
