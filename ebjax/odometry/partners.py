"""Which earlier keyframes a keyframe is measured against: the one before, and two that share less and less floor."""

import numpy as np
from jaxtyping import Float, Int

from ebjax.geometry.planar import between
from ebjax.views.run_view import RunView

SHARED = (0.75, 0.55)
"""The farthest keyframes that still share so much of the floor view are measured too."""
REACH = 12
"""So many keyframes back at most."""
GRID = 12


def common_floor(view: RunView, a_from_b: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    """The share of what view b sees of the floor that view a sees too."""
    height, width = view.size
    seen, floor_from_view = np.asarray(view.seen), np.asarray(view.floor_from_view, float)
    rows, columns = (np.linspace(0, n - 1, GRID).round().astype(int) for n in (height, width))
    v, u = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    v, u = v[seen[v, u]], u[seen[v, u]]
    points = _apply(floor_from_view, np.stack([u, v], 1).astype(float))
    c, s = np.cos(a_from_b[:, 2, None]), np.sin(a_from_b[:, 2, None])
    x = a_from_b[:, 0, None] + c * points[:, 0] - s * points[:, 1]
    y = a_from_b[:, 1, None] + s * points[:, 0] + c * points[:, 1]
    u, v = np.moveaxis(_apply(np.linalg.inv(floor_from_view), np.stack([x, y], -1)), -1, 0)
    inside = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    column, row = (np.clip(np.rint(np.where(inside, a, 0)).astype(int), 0, n - 1) for a, n in ((u, width), (v, height)))
    return (inside & seen[row, column]).mean(1)


def _apply(homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    mapped = np.concatenate([points, np.ones_like(points[..., :1])], -1) @ homography.T
    return mapped[..., :2] / mapped[..., 2:]


def partners_of_last(view: RunView, poses: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, " K"]:
    """As `partners`, of the last keyframe alone: rows of the earlier ones."""
    back = poses[-2 : -REACH - 2 : -1]
    shares = common_floor(view, between(np.broadcast_to(poses[-1], back.shape), back))
    chosen = {1}
    for wanted in SHARED:
        good = np.flatnonzero(shares >= wanted)
        if len(good):
            chosen.add(int(good[-1]) + 1)
    return len(poses) - 1 - np.array(sorted(chosen), int)


def partners(view: RunView, poses: Float[np.ndarray, "N 3"]) -> tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]]:
    """Rows (later, earlier) of the pairs that are measured, from where the keyframes are thought to be.

    Args:
      view: of the run.
      poses: x, y (m) and heading (rad) of every keyframe, as wheels or the steps so far say.
    """
    later: list[int] = []
    earlier: list[int] = []
    count = len(poses)
    shares = np.zeros((count, REACH + 1))
    for gap in range(1, min(REACH, count - 1) + 1):
        shares[gap:, gap] = common_floor(view, between(poses[gap:], poses[:-gap]))
    for k in range(1, count):
        chosen = {1}
        for wanted in SHARED:
            good = np.flatnonzero(shares[k] >= wanted)
            if len(good):
                chosen.add(int(good[-1]))
        for gap in sorted(chosen):
            later.append(k)
            earlier.append(k - gap)
    return np.array(later, int), np.array(earlier, int)
