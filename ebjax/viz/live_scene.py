"""What the live view draws: the floor as it was seen, the path, the closures and the time a frame took, in rerun.

This runs in a process of its own, which `viz.live` starts: rerun's calls wait when its viewer stands still.
"""

import math
import os
import pickle
import signal
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

# Okabe and Ito's colours, which people tell apart who do not see red and green as different.
OPPOSING, SAME, REFUSED = (230, 159, 0), (0, 114, 178), (150, 150, 150)
PATH, ROBOT = (0, 158, 115), (213, 94, 0)
WALL_CLOCK_S = 1e8
"""Stamps above this are seconds since 1970, those below count from some start."""
LAID_PX = 96
"""Longest side of a floor view on the map: a whole one on every metre would fill the viewer's memory."""
CELLS = 12
"""A laid view is so many cells a side, of which those that show floor are drawn."""
LAYERS, LAYER_M = 8, 0.001
"""Views that overlap lie above each other, or they would flicker."""
MOVED_M, MOVED_RAD = 0.01, math.radians(0.5)
"""A view is laid anew when its pose has moved by more than this."""

Pose = Float[np.ndarray, "3"]


class Segment(NamedTuple):
    """A closure: rows of its ends in the path (-1 where unknown), whether they face each other, whether it is kept."""

    rows: tuple[int, int]
    opposing: bool
    kept: bool
    said: str


Segments = dict[tuple[int, int], Segment]
"""By the numbers of both frames."""


class Shown(NamedTuple):
    """Plain values of an update, as `slam.frame.Update` names them."""

    stamp_s: float
    frame: int
    keyframe: int | None
    map_from_base: Pose
    path: Float[np.ndarray, "N 3"] | None
    closures: Segments
    view: UInt8[np.ndarray, "h w 3"] | None
    floor_from_view: Float[np.ndarray, "3 3"]
    milliseconds: float


class Scene:
    """A run in a recording of rerun. Poses are x, y (m) and heading (rad)."""

    def __init__(self, recording: Any):
        import rerun as rr
        import rerun.blueprint as rrb

        self.rr, self.recording = rr, recording
        self.poses = np.zeros((0, 3))
        self.settled = 0
        """Keyframes of the last path that was given."""
        self.closures: Segments = {}
        self.since: Segments = {}
        self.laid: dict[int, Pose] = {}
        recording.send_blueprint(
            rrb.Blueprint(
                rrb.Horizontal(
                    rrb.Spatial3DView(origin="map", name="map"),
                    rrb.Vertical(
                        rrb.Spatial2DView(origin="view", name="floor view"),
                        rrb.TimeSeriesView(origin="milliseconds", name="ms a frame"),
                        rrb.TextLogView(origin="log", name="closures"),
                    ),
                    column_shares=[3, 1],
                ),
                collapse_panels=True,
            )
        )
        recording.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        recording.log("milliseconds", rr.SeriesLines(colors=PATH, names="ms a frame"), static=True)
        arrow = rr.Arrows3D(vectors=[[0.4, 0, 0]], origins=[[0, 0, 0.05]], colors=ROBOT, radii=0.03)
        recording.log("map/robot", arrow, static=True)

    def show(self, update: Shown) -> None:
        """Draws what an update changes."""
        rr, log = self.rr, self.recording.log
        stamp: dict[str, Any] = {"timestamp" if update.stamp_s > WALL_CLOCK_S else "duration": update.stamp_s}
        self.recording.set_time("stamp", **stamp)
        self.recording.set_time("frame", sequence=update.frame)
        log("map/robot", self._at(update.map_from_base))
        log("milliseconds", rr.Scalars(update.milliseconds))
        if update.keyframe is not None:
            self._keyframe(update.keyframe, update.map_from_base)
        if update.view is not None:
            log("view", rr.Image(update.view).compress(jpeg_quality=85))
            if update.keyframe is not None:
                self._lay(update.keyframe, update.view, update.floor_from_view)
        if update.path is not None:
            self._path(update.path)
        if update.closures or update.path is not None:
            self._close(update.closures, anew=update.path is not None)

    def _keyframe(self, k: int, pose: Pose) -> None:
        if k >= len(self.poses):
            self.poses = np.concatenate([self.poses, np.full((k + 1 - len(self.poses), 3), np.nan)])
        self.poses[k] = pose
        self._strip("map/path/newest", self.poses[max(self.settled - 1, 0) :])

    def _path(self, path: Float[np.ndarray, "N 3"]) -> None:
        """The path as a solve corrected it, and the floor views with it."""
        self.poses = np.concatenate([path, self.poses[len(path) :]])
        self.settled = len(path)
        self._strip("map/path", path)
        self._strip("map/path/newest", self.poses[max(self.settled - 1, 0) :])
        for k, before in self.laid.items():
            moved = self.poses[k] - before
            turned = abs((moved[2] + math.pi) % (2 * math.pi) - math.pi)
            if math.hypot(*moved[:2]) > MOVED_M or turned > MOVED_RAD:
                self._place(k)

    def _close(self, closures: Segments, *, anew: bool) -> None:
        """Closures that were kept, and those that were looked at since the last path, refused ones too."""
        for closure in closures.values():
            level = self.rr.TextLogLevel.INFO if closure.kept else self.rr.TextLogLevel.DEBUG
            self.recording.log("log", self.rr.TextLog(closure.said, level=level))
        self.since |= closures
        if anew or not self.closures.keys().isdisjoint(closures):
            self.closures = {pair: one for pair, one in (self.closures | self.since).items() if one.kept}
            self.since = {}
            self._segments("map/closures/opposing", [one for one in self.closures.values() if one.opposing])
            self._segments("map/closures/same", [one for one in self.closures.values() if not one.opposing])
        self._segments("map/closures/newest", list(self.since.values()))

    def _segments(self, name: str, closures: list[Segment]) -> None:
        known = [one for one in closures if min(one.rows) >= 0 and max(one.rows) < len(self.poses)]
        rows = np.array([one.rows for one in known], int).reshape(-1, 2)
        ends = np.concatenate([self.poses[rows][..., :2], np.full((*rows.shape, 1), 0.02)], -1)
        colours = np.array([(OPPOSING if one.opposing else SAME) if one.kept else REFUSED for one in known], np.uint8)
        finite = np.isfinite(ends).all((1, 2))
        shown = self.rr.LineStrips3D(ends[finite], colors=colours.reshape(-1, 3)[finite], radii=0.01)
        self.recording.log(name, shown)

    def _strip(self, name: str, poses: Float[np.ndarray, "N 3"]) -> None:
        known = poses[np.isfinite(poses).all(1), :2]
        points = np.concatenate([known, np.full((len(known), 1), 0.01)], 1)
        self.recording.log(name, self.rr.LineStrips3D([points] if len(points) > 1 else [], colors=PATH, radii=0.015))

    def _lay(self, k: int, view: UInt8[np.ndarray, "h w 3"], floor_from_view: Float[np.ndarray, "3 3"]) -> None:
        """Lays a view on the map where the last one that was laid lies half a view away, or was turned otherwise."""
        mesh, extent_m = floor_mesh(view, floor_from_view)
        if self.laid:
            moved = self.poses[k] - self.poses[next(reversed(self.laid))]
            near = math.hypot(*moved[:2]) < extent_m / 2 and math.cos(moved[2]) > math.cos(math.pi / 4)
            if near:
                return
        if len(mesh["triangle_indices"]):
            self.recording.log(f"map/floor/{k}", self.rr.Mesh3D(**mesh))
            self._place(k)

    def _place(self, k: int) -> None:
        self.laid[k] = self.poses[k].copy()
        self.recording.log(f"map/floor/{k}", self._at(self.poses[k], -LAYER_M * (1 + k % LAYERS)))

    def _at(self, pose: Pose, z: float = 0.0) -> Any:
        turn = self.rr.RotationAxisAngle(axis=[0, 0, 1], angle=self.rr.Angle(rad=float(pose[2])))
        return self.rr.Transform3D(translation=[float(pose[0]), float(pose[1]), z], rotation=turn)


def floor_mesh(
    view: UInt8[np.ndarray, "h w 3"], floor_from_view: Float[np.ndarray, "3 3"]
) -> tuple[dict[str, np.ndarray], float]:
    """A floor view as a textured mesh in base, without the cells that are black, and its longer side, m."""
    height, width = view.shape[:2]
    shrink = math.ceil(max(height, width) / LAID_PX)
    texture = view[: height // shrink * shrink, : width // shrink * shrink]
    blocks = texture.reshape(height // shrink, shrink, width // shrink, shrink, 3)
    texture = np.rint(blocks.mean((1, 3))).astype(np.uint8)
    across, down = np.meshgrid(np.linspace(0, 1, CELLS + 1), np.linspace(0, 1, CELLS + 1))
    shares = np.stack([across.ravel(), down.ravel()], 1)
    size = np.array([texture.shape[1], texture.shape[0]]) * shrink
    floor = np.concatenate([shares * size - 0.5, np.ones((len(shares), 1))], 1) @ floor_from_view.T
    points = np.concatenate([floor[:, :2] / floor[:, 2:], np.zeros((len(shares), 1))], 1)

    lit = texture.any(-1)
    middles = (np.arange(CELLS) + 0.5) / CELLS
    rows, columns = (middles * lit.shape[0]).astype(int), (middles * lit.shape[1]).astype(int)
    row, column = np.nonzero(lit[np.ix_(rows, columns)])
    corner = row * (CELLS + 1) + column
    near, far = corner, corner + CELLS + 1
    triangles = np.concatenate([np.stack([near, far, near + 1], 1), np.stack([near + 1, far, far + 1], 1)])
    mesh = {
        "vertex_positions": points,
        "triangle_indices": triangles,
        "vertex_texcoords": shares,
        "albedo_texture": texture,
    }
    return mesh, float(np.ptp(points, axis=0).max())


def serve(save: str | None) -> None:
    """Draws the updates that come pickled on standard input, into a file or a viewer, until it ends.

    Writes one line on standard output first: empty, or what is wrong.
    """
    # ctrl-C ends the run, and the run ends this: what it still sends is drawn.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The viewer inherits standard input and output, and would keep the run's pipes open.
    updates, answer = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    try:
        import rerun as rr

        recording = rr.RecordingStream("ebjax")
        if save is None:
            recording.spawn()
        else:
            recording.save(save)
        scene = Scene(recording)
    except Exception as fault:
        print(" ".join(f"{type(fault).__name__}: {fault}".split()), file=answer, flush=True)
        return
    print(file=answer, flush=True)
    while True:
        try:
            update = pickle.load(updates)
        except (EOFError, pickle.UnpicklingError):  # the run ended, or was ended within an update
            break
        scene.show(update)
    try:
        recording.flush()
    except RuntimeError:  # the viewer was closed, or the disk is full: rerun has said so
        raise SystemExit(1) from None
    recording.disconnect()
