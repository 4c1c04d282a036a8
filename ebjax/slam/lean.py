"""How a robot leans as it drives, by odometry, depth or the floor views, and whether the views agree with it.

Odometry from wheels and an IMU knows how the robot nods; visual odometry that drifts in tilt does not.
"""

import dataclasses
from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from ebjax.features.extractor import Extractor
from ebjax.geometry.camera import Camera
from ebjax.geometry.lean_numbers import levels_from_usual
from ebjax.geometry.planar import between
from ebjax.odometry.nods import bent_pairs, nods
from ebjax.places.descriptor import Descriptor
from ebjax.slam.look import Eyes, Looked
from ebjax.slam.packed import packed
from ebjax.slam.recording import Load
from ebjax.slam.store import InMemory
from ebjax.views.depth_floor import floor_planes
from ebjax.views.run_view import RunView

By = Literal["odometry", "depth", "floor"]
PAIRS = 12
GAPS = (1, 2, 4)
WHEELS, WHEELS_M = 0.02, 0.003
"""How wheels may err: a share of the way and of the turn, and m."""
CLEARLY = 1.5
LEAST_DEG, KNOWN_DEG = 0.15, 0.5
"""A smaller lean is none; one that is not known so well is left out."""
TOLERANCE_M = 0.01
STRIDE = 4
"""Rows and columns between the depth pixels that the floor is fitted to."""
LEAST_KNOWN = 0.5
"""Share of keyframes whose depth must show a floor."""


@dataclasses.dataclass(frozen=True)
class Lean:
    """How a robot leans, and what the floor says of that.

    Attributes:
      level_from_base: at every frame.
      by: what says so.
      rms_deg: of roll and pitch.
      agree: matches of successive floor views that agree to 1 cm, with it and without.
    """

    level_from_base: Float[np.ndarray, "F 4 4"]
    by: By
    rms_deg: float
    agree: tuple[int, int]

    @property
    def used(self) -> bool:
        """Whether floor views agree at least as well with what odometry says; clearly better with what they say."""
        if self.by == "odometry":
            return self.agree[0] >= self.agree[1]
        return self.agree[0] > CLEARLY * self.agree[1]

    def says(self) -> str:
        """In one line."""
        used = "looked at accordingly" if self.used else "not used, as floor views agree worse with it"
        what = {
            "odometry": "odometry's roll and pitch",
            "depth": "the robot nods, as the floor in the depth images shows",
            "floor": "the robot nods, as the floor views show",
        }[self.by]
        return (
            f"{what}, {self.rms_deg:.2f} degrees rms: {used} "
            f"({self.agree[0]} matches agree with it, {self.agree[1]} without)"
        )


def used(lean: Lean | None) -> Float[np.ndarray, "F 4 4"] | None:
    """level_from_base where it is used."""
    return lean.level_from_base if lean is not None and lean.used else None


def image_level(lean: Lean | None) -> Float[np.ndarray, "F 4 4"] | None:
    """level_from_base where it is used of whole images: what floor views say of a lean says little in turns."""
    return None if lean is None or lean.by == "floor" else used(lean)


def shown_by_the_floor(
    looked: Looked,
    start: int,
    frames: Int[np.ndarray, " N"],
    timestamps: Float[np.ndarray, " F"],
    wheels: Float[np.ndarray, "F 3"] | None,
    seed: int,
) -> Float[np.ndarray, "F 4 4"] | None:
    """How the robot leans at every frame, solved from successive floor views; None where that is next to nothing."""
    count = len(frames)
    gaps = [gap for gap in GAPS if gap < count]
    i = np.concatenate([np.arange(gap, count) for gap in gaps])
    j = np.concatenate([np.arange(count - gap) for gap in gaps])
    matches = bent_pairs(lambda rows: looked.stacked_landmarks(start + rows), looked.view, looked.camera, i, j, seed)
    counted = None
    if wheels is not None:
        steps = between(wheels[frames[i]], wheels[frames[j]])
        far = np.hypot(steps[:, 0], steps[:, 1])[:, None]
        counted = steps, WHEELS * far + WHEELS_M + np.array([[0.0, 0.0, WHEELS]]) * np.abs(steps[:, 2:])
    found = nods(matches, i, j, count, looked.camera, times=timestamps[frames], wheels=counted)
    known = found.sigma.max(1) < np.radians(KNOWN_DEG)
    lean = np.where(known[:, None], found.lean, 0.0)
    if not known.any() or np.degrees(np.sqrt((lean[known] ** 2).sum(1).mean())) < LEAST_DEG:
        return None
    return dataclasses.replace(found, lean=lean).level_from_base(frames, len(timestamps))


def shown_by_depth(
    load: Load, keyframes: Int[np.ndarray, " N"], camera: Camera, count: int
) -> Float[np.ndarray, "F 4 4"] | None:
    """How the robot leans at every keyframe, by the floor in its depth image; None where that is next to nothing."""
    images = (load(frame) for frame in keyframes.tolist())
    planes = floor_planes((None if image is None else image[1] for image in images), camera, stride=STRIDE)
    known = np.isfinite(planes[:, 0])
    if known.mean() < LEAST_KNOWN:
        return None
    up = planes[known, :3] @ np.asarray(camera.base_from_camera, np.float64)[:3, :3].T
    level = levels_from_usual(up)
    if np.degrees(np.sqrt((level[:, 2, :2] ** 2).sum(1).mean())) < LEAST_DEG:
        return None
    found = np.tile(np.eye(4), (count, 1, 1))
    found[keyframes[known]] = level
    return found


@dataclasses.dataclass(frozen=True)
class Asked:
    """What floor views are made and compared with, to ask them about a lean."""

    load: Load
    camera: Camera
    view_of: Callable[[Camera], RunView]
    extractor: Extractor
    descriptor: Descriptor
    seed: int

    def leaning(self, by: By, frames: list[int], level_from_base: Float[np.ndarray, "F 4 4"] | None) -> Lean | None:
        """Compares the pairs of successive frames between which the lean changes most, with it and without.

        Nothing where `by` says nothing of a lean.
        """
        if level_from_base is None:
            return None
        lean = np.degrees(np.arcsin(np.clip(level_from_base[:, 2, :2], -1, 1)))
        seen = lean[frames]
        change = np.linalg.norm(np.diff(seen, axis=0), axis=1)
        firsts = np.sort(np.argsort(-change, kind="stable")[:PAIRS])
        pairs = [(frames[k + 1], frames[k]) for k in firsts.tolist()]
        agree = self.agree(pairs, level_from_base), self.agree(pairs)
        return Lean(level_from_base, by, float(np.sqrt((seen**2).sum(1).mean())), agree)

    def agree(
        self,
        pairs: list[tuple[int, int]],
        level_from_base: Float[np.ndarray, "F 4 4"] | None = None,
        camera: Camera | None = None,
    ) -> int:
        """Matches of all pairs of frames that agree to 1 cm, where the robot leans so, or sees by another camera."""
        camera = camera or self.camera
        images = {frame: self.load(frame) for frame in sorted({frame for pair in pairs for frame in pair})}
        eyes, store = Eyes(camera, self.view_of(camera), self.extractor, self.descriptor), InMemory()
        row: dict[int, int] = {}
        for frame, image in images.items():
            if image is not None:
                level = None if level_from_base is None else level_from_base[frame]
                row[frame] = len(store)
                store.keep(packed(eyes.describe(*image, level)))
        looked = Looked(store, eyes.view, camera, self.extractor.turn, TOLERANCE_M, self.seed)
        known = [(row[i], row[j]) for i, j in pairs if i in row and j in row]
        return int(looked.pairs(*np.array(known, int).reshape(-1, 2).T).inliers.sum())
