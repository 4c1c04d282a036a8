"""What goes into the engine and what it says: frames, updates."""

import dataclasses

import numpy as np
from jaxtyping import Float, UInt8


@dataclasses.dataclass(frozen=True)
class Frame:
    """One image of a run and what was measured with it.

    Attributes:
      stamp_s: its time, s; later than that of every frame before it.
      rgb: the image, of the camera's size; None where it could not be read, or need not be as the robot hardly moved.
      depth_m: along the optical axis, m, 0 where missing; None without.
      odom_from_base: x, y (m) and heading (rad) by odometry; None without wheels.
      name: of the image.
    """

    stamp_s: float
    rgb: UInt8[np.ndarray, "H W 3"] | None
    depth_m: Float[np.ndarray, "H W"] | None = None
    odom_from_base: Float[np.ndarray, "3"] | None = None
    name: str = ""

    def __repr__(self) -> str:
        image = "no image" if self.rgb is None else f"{self.rgb.shape[1]} x {self.rgb.shape[0]}"
        depth = "" if self.depth_m is None else ", depth"
        odom = "no odometry" if self.odom_from_base is None else f"odometry {_pose(self.odom_from_base)}"
        return f"Frame({self.name or 'unnamed'} at {self.stamp_s:.3f} s: {image}{depth}, {odom})"


@dataclasses.dataclass(frozen=True)
class Closure:
    """A measured candidate whose standing is new: frames i > j, the motion between them, and whether it is believed.

    Attributes:
      i: number of the later frame.
      j: number of the earlier frame.
      opposing: whether they look at the floor from opposite sides.
      i_from_j: x, y (m), heading (rad).
      kept: whether it is believed.
      reason: "kept", or why not.
      rows: of the two keyframes, the later first; the earlier may be of an earlier run, whose frames it numbers.
    """

    i: int
    j: int
    opposing: bool
    i_from_j: Float[np.ndarray, "3"]
    kept: bool
    reason: str
    rows: tuple[int, int] = (-1, -1)


@dataclasses.dataclass(frozen=True)
class Update:
    """What a frame told.

    Attributes:
      frame: its number.
      stamp_s: its time, s.
      keyframe: its row among the keyframes; None where it is none.
      map_from_base: where the robot is: x, y (m), heading (rad).
      in_map: whether that is in the frame of the map's first run; else in the run's own.
      map_from_odom: what puts odometry right (REP 105); None without wheels. It may jump.
      covariance: of map_from_base in its right tangent, as the steps since the last correction make it.
      closures: candidates that are new, believed since, or taken back.
      path: of all keyframes in the map, where a correction came; None else.
      view: the floor view of a keyframe, RGB.
      milliseconds: that `add` took.
    """

    frame: int
    stamp_s: float
    keyframe: int | None
    map_from_base: Float[np.ndarray, "3"]
    in_map: bool
    map_from_odom: Float[np.ndarray, "3"] | None
    covariance: Float[np.ndarray, "3 3"]
    closures: tuple[Closure, ...] = ()
    path: Float[np.ndarray, "N 3"] | None = None
    view: UInt8[np.ndarray, "h w 3"] | None = None
    milliseconds: float = 0.0

    def __repr__(self) -> str:
        kind = "" if self.keyframe is None else f", keyframe {self.keyframe}"
        news = f", {sum(closure.kept for closure in self.closures)} closures believed" if self.closures else ""
        return f"Update(frame {self.frame}{kind} at {_pose(self.map_from_base)}{news}, {self.milliseconds:.0f} ms)"


def _pose(pose: Float[np.ndarray, "3"]) -> str:
    return f"{pose[0]:.3f} m, {pose[1]:.3f} m, {np.degrees(pose[2]):.1f} degrees"
