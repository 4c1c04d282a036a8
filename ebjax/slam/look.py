"""Keyframes as they are looked at under one camera: described one by one, kept packed, verified in pairs."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ebjax.features.extractor import Extractor
from ebjax.features.landmarks import Landmarks
from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import VerifiedPair, pair_numbers, stacked, verify_pair
from ebjax.geometry.camera import Camera
from ebjax.odometry.floor_steps import FloorPairs
from ebjax.places.descriptor import Descriptor
from ebjax.slam.describe import Described, describe, describe_view
from ebjax.slam.latest import Latest
from ebjax.slam.one_piece import in_one_piece
from ebjax.slam.packed import Arrays, floor_of, landmarks_of, view_of
from ebjax.slam.store import Shelf
from ebjax.slam.told import Ends, Told
from ebjax.views.floor_view import view_taps
from ebjax.views.run_view import RunView, remounted_view
from ebjax.views.tilted import tilted

LANDMARKS, PAIRS = 256, 1024
"""Keyframes and pairs that are held unpacked: about 60 and 25 MB; others are read and verified again."""
TOGETHER = 8
"""Pairs that are verified at a time."""
_taps = jax.jit(view_taps)
_pool = ThreadPoolExecutor(2)


class Eyes:
    """What images are looked at with.

    Attributes:
      camera: of the run.
      view: the floor it looks at.
      extractor: of local features.
      descriptor: of places.
    """

    def __init__(self, camera: Camera, view: RunView, extractor: Extractor, descriptor: Descriptor):
        self.camera, self.view, self.extractor, self.descriptor = camera, view, extractor, descriptor
        self._samples = _taps(view, camera)
        self._blank = np.zeros((camera.height, camera.width), np.float32)

    def describe(
        self,
        rgb: UInt8[np.ndarray, "H W 3"],
        depth_m: Float[np.ndarray, "H W"] | None,
        level_from_base: Float[np.ndarray, "4 4"] | None = None,
    ) -> Described:
        """Describes an image.

        Args:
          rgb: of the camera's size.
          depth_m: along the optical axis, 0 where missing; None without.
          level_from_base: how the robot leans; None: it does not.
        """
        depth = self._blank if depth_m is None else depth_m
        describing = partial(describe, rgb, depth, extractor=self.extractor, descriptor=self.descriptor)
        if level_from_base is None:
            return describing(self._samples, self.view, self.camera)
        view, camera = tilted(self.view, self.camera, level_from_base)
        return describing(_taps(view, camera), view, camera).levelled(self.view, self.camera)

    def describe_view(self, shown: UInt8[np.ndarray, "h w 3"], floor: Bool[np.ndarray, "h w"]) -> Described:
        """Describes a floor view that was kept, RGB, and what of it is floor; no depth is known of it."""
        return describe_view(shown, floor, self.view, self.camera, extractor=self.extractor, descriptor=self.descriptor)


class Looked:
    """Packed keyframes, unpacked and verified when asked for.

    Attributes:
      store: of the packed ones.
      view: of the run.
      camera: as it is believed to be mounted.
      told: what every pair that was verified gave, in few numbers, by its later keyframe.
    """

    def __init__(
        self, store: Shelf, view: RunView, camera: Camera, turn: Callable | None, tolerance_m: float, seed: int
    ):
        self.store, self.view, self.camera = store, view, camera
        self._turn, self._tolerance_m, self._seed = turn, tolerance_m, seed
        self._landmarks: Latest[tuple[int, bool], Landmarks] = Latest(LANDMARKS)
        self._pairs: Latest[tuple[int, int, bool], VerifiedPair] = Latest(PAIRS)
        self.told: defaultdict[int, dict[Ends, Told]] = defaultdict(dict)

    def under(self, camera: Camera) -> "Looked":
        """The same keyframes under another mount of the camera."""
        if camera is self.camera:
            return self
        view = remounted_view(self.view, camera)
        return Looked(self.store, view, camera, self._turn, self._tolerance_m, self._seed)

    def seen(self, row: int) -> UInt8[np.ndarray, "h w 3"]:
        """The floor view of a keyframe."""
        return view_of(self.store.arrays(row))

    def floor(self, row: int) -> Bool[np.ndarray, "h w"]:
        """What of it is floor."""
        return floor_of(self.store.arrays(row))

    def landmarks(self, row: int, facing: bool = False) -> Landmarks:
        """The features of a keyframe; those of its view turned by pi where `facing`."""
        if (row, facing) not in self._landmarks:
            kept = self.store.arrays(row)
            self._landmarks[row, facing] = in_one_piece(landmarks_of(kept, self.view, self.camera, self._turn, facing))
        return self._landmarks[row, facing]

    def compile_facing(self, kept: Arrays) -> None:
        """Makes the program of views turned by pi before one is asked for; may run in a thread."""
        landmarks_of(kept, self.view, self.camera, self._turn, True)

    def stacked_landmarks(self, rows: Sequence[int] | Int[np.ndarray, " n"]) -> Landmarks:
        """Of several keyframes."""
        found = [self.landmarks(int(row)) for row in rows]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *found)

    def pair(self, i: int, j: int, opposing: bool) -> VerifiedPair:
        """What two keyframes have in common, i the later."""
        return self._verified([(i, j, opposing)])[0]

    def _verified(self, ends: Sequence[tuple[int, int, bool]]) -> list[VerifiedPair]:
        """A few pairs, side by side: one by itself leaves cores idle."""
        known = {end: self._pairs[end] for end in ends if end in self._pairs}
        begun = {end: _pool.submit(self._ready(*end)) for end in ends if end not in known}
        for end, waited in begun.items():
            self._pairs[end] = known[end] = waited.result()
        return [known[end] for end in ends]

    def _ready(self, i: int, j: int, opposing: bool) -> Callable[[], VerifiedPair]:
        """What verifies two keyframes, wherever it is called."""
        ends, numbers = (self.landmarks(i), self.landmarks(j, opposing)), pair_numbers(self._seed, i, j, opposing)
        given = numbers, self.view, self.camera, self._tolerance_m
        return lambda: in_one_piece(verify_pair(*ends, *given))

    def pairs(
        self,
        i: Int[np.ndarray, " K"],
        j: Int[np.ndarray, " K"],
        opposing: Bool[np.ndarray, " K"] | None = None,
        since: int = 0,
    ) -> FloorPairs:
        """Many of them; rows count from `since` on."""
        ways = np.zeros(len(i), bool) if opposing is None else opposing
        ends = list(zip((i + since).tolist(), (j + since).tolist(), ways.tolist(), strict=True))
        told = self._told(ends)

        def matches(rows: Int[np.ndarray, " n"]) -> PairMatches:
            found = self._verified([ends[k] for k in rows.tolist()])
            return jax.tree.map(lambda *leaves: np.stack(leaves), *(one.matches for one in found))

        inliers, total = np.array([one[:2] for one in told], int).reshape(-1, 2).T
        return FloorPairs(i, j, inliers, total, matches, stacked(one.settled for one in told))

    def _told(self, ends: list[tuple[int, int, bool]]) -> list[Told]:
        lacking = [(i, j, opposing) for i, j, opposing in ends if (j, opposing) not in self.told[i]]
        for first in range(0, len(lacking), TOGETHER):
            some = lacking[first : first + TOGETHER]
            for (i, j, opposing), found in zip(some, self._verified(some), strict=True):
                self.told[i][j, opposing] = Told.of(found)
        return [self.told[i][j, opposing] for i, j, opposing in ends]


class Views(Sequence):
    """The floor views of some keyframes, read when asked for."""

    def __init__(self, looked: Looked, rows: Int[np.ndarray, " N"]):
        self._looked, self._rows = looked, rows

    def __len__(self) -> int:
        """Returns how many there are."""
        return len(self._rows)

    def __getitem__(self, k):
        """The floor view of the k-th."""
        return self._looked.seen(int(self._rows[k]))
