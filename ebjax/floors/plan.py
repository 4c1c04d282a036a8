"""Floor plans: corridors along polylines, open where they meet, as rectangles of floor and the walls around them.

NumPy, metres, made once. A polyline is written "x y, x y, ..."; its first and last point may be the same (a loop).
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

NUDGE_M = 1e-5


@dataclasses.dataclass(frozen=True)
class PlanConfig:
    """The corridors."""

    corridors: tuple[str, ...] = ()
    """Polylines along their middles, "x y, x y, ...", m; none: one along the robot's route."""
    width_m: float = 2.4
    """Between the walls, m."""
    margin_m: float = 2.0
    """From the end of a corridor that meets no other to the wall that closes it, m."""
    door_spacing_m: float = 2.4
    """Between identical doors, m."""
    ramp: str = ""
    """Foot and top of a ramp, "x y, x y", m: from the line across at the first point to that at the second the floor
    climbs, beyond it stays up, in all corridors; none: the floor is level."""
    ramp_deg: float = 0.0
    """Slope of that ramp, degrees; below 0 it goes down."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """Rectangles of floor of one width, and the walls around their union.

    Attributes:
      origins: right corner of each rectangle's start, seen along it, m.
      directions: unit vectors along them.
      lengths: m.
      width_m: of all.
      walls: start and end of each piece of wall; the floor lies on its left.
    """

    origins: Float[np.ndarray, "S 2"]
    directions: Float[np.ndarray, "S 2"]
    lengths: Float[np.ndarray, " S"]
    width_m: float
    walls: Float[np.ndarray, "N 2 2"]

    def inside(self, points: Float[np.ndarray, "N 2"], clearance_m: float = 0.0) -> Bool[np.ndarray, "S N"]:
        """Tells which rectangles hold which points, that far from their sides; ends need no clearance."""
        offset = points[None] - self.origins[:, None]
        along = np.sum(offset * self.directions[:, None], axis=-1)
        left = np.stack([-self.directions[:, 1], self.directions[:, 0]], axis=-1)
        across = np.sum(offset * left[:, None], axis=-1)
        in_width = (across >= clearance_m) & (across <= self.width_m - clearance_m)
        return np.asarray(in_width & (along >= 0) & (along <= self.lengths[:, None]))

    def owns(self, rectangle: int, points: Float[np.ndarray, "N 2"]) -> Bool[np.ndarray, " N"]:
        """Tells which points lie in no rectangle before this one."""
        return ~np.any(self.inside(points)[:rectangle], axis=0)


def polyline(text: str, key: str) -> Float[np.ndarray, "K 2"]:
    """Reads "x y, x y, ...".

    Raises:
      ValueError: fewer than two points, or two equal ones in a row; names the key.
    """
    try:
        points = np.array([[float(number) for number in pair.split()] for pair in text.split(",")])
    except ValueError:
        points = np.zeros((0, 2))
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.all(np.isfinite(points)):
        raise ValueError(f'{key} is {text!r}: needs points "x y, x y, ..." in metres')
    if np.any(np.linalg.norm(np.diff(points, axis=0), axis=1) < 0.1):
        raise ValueError(f"{key} is {text!r}: needs points at least 0.1 m from the one before")
    return points


def make_plan(lines: list[Float[np.ndarray, "_ 2"]], width_m: float, margin_m: float) -> Plan:
    """One rectangle a side of each polyline: half a width longer at bends, `margin_m` longer at dead ends."""
    starts = np.concatenate([line[:-1] for line in lines])
    ends = np.concatenate([line[1:] for line in lines])
    half, bare = width_m / 2, _rectangles(starts, ends, 0.0, 0.0, width_m)
    before: list[float] = []
    after: list[float] = []
    for line in lines:
        closed = np.allclose(line[0], line[-1])
        own = slice(len(before), len(before) + len(line) - 1)
        others = np.delete(np.arange(len(starts)), np.arange(own.start, own.stop))
        outer = [
            half if closed else 0.0 if meets else margin_m
            for meets in np.any(bare.inside(line[[0, -1]])[others], axis=0)
        ]
        before += [outer[0]] + [half] * (len(line) - 2)
        after += [half] * (len(line) - 2) + [outer[1]]
    plan = _rectangles(starts, ends, np.array(before), np.array(after), width_m)
    return dataclasses.replace(plan, walls=_walls(plan))


def _rectangles(starts, ends, before, after, width_m: float) -> Plan:
    """So much longer before the start and after the end of each side; no walls yet."""
    sides = ends - starts
    lengths = np.linalg.norm(sides, axis=1)
    directions = sides / lengths[:, None]
    left = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
    origins = starts - np.broadcast_to(before, lengths.shape)[:, None] * directions - width_m / 2 * left
    return Plan(origins, directions, lengths + before + after, width_m, np.zeros((0, 2, 2)))


def _walls(plan: Plan) -> Float[np.ndarray, "N 2 2"]:
    """The sides of every rectangle, without the parts that lie inside another one."""
    left = np.stack([-plan.directions[:, 1], plan.directions[:, 0]], axis=1)
    right_end = plan.origins + plan.lengths[:, None] * plan.directions
    corners = np.stack(
        [plan.origins, right_end, right_end + plan.width_m * left, plan.origins + plan.width_m * left], 1
    )
    walls = []
    for i, corner in enumerate(corners):
        for start, end in zip(corner, np.roll(corner, -1, axis=0), strict=True):
            side = end - start
            inward = np.array([-side[1], side[0]]) / np.linalg.norm(side)
            pieces = [(0.0, 1.0)]
            for j in range(len(corners)):
                if j == i:
                    continue
                # Where the sides of two rectangles coincide, the first one's is the wall.
                nudge = (NUDGE_M if j < i else -NUDGE_M) * inward
                low, high = _inside_share(plan, j, start + nudge, end + nudge)
                if low < high:
                    pieces = [piece for a, b in pieces for piece in ((a, min(b, low)), (max(a, high), b))]
                    pieces = [(a, b) for a, b in pieces if (b - a) * np.linalg.norm(side) > 10 * NUDGE_M]
            walls += [(start + a * side, start + b * side) for a, b in pieces]
    return np.array(walls).reshape(-1, 2, 2)


def _inside_share(plan: Plan, rectangle: int, start, end) -> tuple[float, float]:
    """The part of a segment that lies inside a rectangle, as shares of the segment; empty where low >= high."""
    direction = plan.directions[rectangle]
    frame = np.stack([direction, [-direction[1], direction[0]]])
    a, step = frame @ (start - plan.origins[rectangle]), frame @ (end - start)
    low, high = 0.0, 1.0
    for k, size in enumerate((plan.lengths[rectangle], plan.width_m)):
        if abs(step[k]) < 1e-9:
            if not 0 < a[k] < size:
                return 0.0, 0.0
            continue
        first, last = sorted([(0.0 - a[k]) / step[k], (size - a[k]) / step[k]])
        low, high = max(low, first), min(high, last)
    return low, high
