"""A run with ground truth, as the tables look at it: its frames on the way out and on the way back, and its floor view.

Queries are the frames of the way back, references those of the way out. The ways part where half the path is driven.
"""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ebjax.geometry.camera import Camera, camera_from
from ebjax.io.sequence import Sequence, read_sequence
from ebjax.slam.drive import moved_enough
from ebjax.slam.world import planar
from ebjax.views.run_view import RunView, choose_floor, from_camera

METRES_PER_PX = 0.01
STEP_M, STEP_DEG = 0.15, 10.0


@dataclasses.dataclass(frozen=True)
class Run:
    """A run.

    Attributes:
      sequence: its files.
      truth: x, y (m) and heading (rad) of every frame.
      camera: float64.
      view: the floor that is looked at, metric.
      out: frames of the way out that are looked at.
      back: of the way back.
    """

    sequence: Sequence
    truth: Float[np.ndarray, "N 3"]
    camera: Camera
    view: RunView
    out: Int[np.ndarray, " A"]
    back: Int[np.ndarray, " B"]

    @property
    def frames(self) -> Int[np.ndarray, " C"]:
        """Both ways, in time order."""
        return np.concatenate([self.out, self.back])

    @property
    def distances_m(self) -> Float[np.ndarray, " N"]:
        """Length of the true path up to every frame, m."""
        return _travelled(self.truth)

    @property
    def travelled_m(self) -> float:
        """Length of the true path, out and back, m."""
        return float(self.distances_m[-1])


def _travelled(truth: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1))])


def read_run(path: Path) -> Run:
    """Reads a sequence in TUM layout.

    Raises:
      ValueError: no ground truth for all its frames, nothing driven, or anything `read_sequence` raises.
    """
    sequence = read_sequence(path)
    if sequence.world_from_base is None or not np.isfinite(sequence.world_from_base).all():
        raise ValueError(f"{path / 'groundtruth.txt'}: the tables need ground truth for every frame")
    truth = planar(sequence.world_from_base)
    file = sequence.camera
    camera = camera_from(file)
    try:
        view = from_camera(camera, choose_floor(camera, METRES_PER_PX))
    except ValueError as fault:
        raise ValueError(f"{path / 'camera.json'}: {fault}") from None
    frames = np.array(moved_enough(truth, STEP_M, STEP_DEG))
    driven = _travelled(truth)[frames]
    returning = driven > driven[-1] / 2
    if returning.sum() < 2 or (~returning).sum() < 2:
        raise ValueError(f"{path}: {len(frames)} frames that moved; a run out and back needs more")
    return Run(sequence, truth, camera, view, frames[~returning], frames[returning])
