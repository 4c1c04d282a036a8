"""Keyframes as they are looked at under one camera: described one by one, kept packed, verified in pairs."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
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
from ebjax.slam.describe import Described, describe
from ebjax.slam.packed import floor_of, landmarks_of, view_of
from ebjax.slam.store import Shelf
from ebjax.slam.told import Pair, Told
from ebjax.views.floor_view import view_taps
from ebjax.views.run_view import RunView, remounted_view
from ebjax.views.tilted import tilted

LANDMARKS, PAIRS = 256, 1024
"""Keyframes and pairs that are held unpacked: about 60 and 25 MB; others are read and verified again."""
_taps = jax.jit(view_taps)


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


class Looked:
    """Packed keyframes, unpacked and verified when asked for.

    Attributes:
      store: of the packed ones.
      view: of the run.
      camera: as it is believed to be mounted.
      told: what every pair that was verified gave, in few numbers.
    """

    def __init__(
        self, store: Shelf, view: RunView, camera: Camera, turn: Callable | None, tolerance_m: float, seed: int
    ):
        self.store, self.view, self.camera = store, view, camera
        self._turn, self._tolerance_m, self._seed = turn, tolerance_m, seed
        self._landmarks: OrderedDict[tuple[int, bool], Landmarks] = OrderedDict()
        self._pairs: OrderedDict[Pair, VerifiedPair] = OrderedDict()
        self.told: dict[Pair, Told] = {}

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
        return _remembered(self._landmarks, (row, facing), LANDMARKS, partial(self._unpacked, row, facing))

    def _unpacked(self, row: int, facing: bool) -> Landmarks:
        return landmarks_of(self.store.arrays(row), self.view, self.camera, self._turn, facing)

    def stacked_landmarks(self, rows: Sequence[int] | Int[np.ndarray, " n"]) -> Landmarks:
        """Of several keyframes."""
        found = [jax.tree.map(np.asarray, self.landmarks(int(row))) for row in rows]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *found)

    def pair(self, i: int, j: int, opposing: bool) -> VerifiedPair:
        """What two keyframes have in common, i the later."""
        return _remembered(self._pairs, (i, j, opposing), PAIRS, partial(self._verified, i, j, opposing))

    def _verified(self, i: int, j: int, opposing: bool) -> VerifiedPair:
        ends = self.landmarks(i), self.landmarks(j, opposing)
        found = verify_pair(*ends, pair_numbers(self._seed, i, j, opposing), self.view, self.camera, self._tolerance_m)
        return jax.tree.map(np.asarray, found)

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
        told = [self.told[end] if end in self.told else self._tell(end) for end in ends]

        def matches(rows: Int[np.ndarray, " n"]) -> PairMatches:
            return jax.tree.map(lambda *leaves: np.stack(leaves), *(self.pair(*ends[k]).matches for k in rows.tolist()))

        inliers, total = np.array([one[:2] for one in told], int).reshape(-1, 2).T
        return FloorPairs(i, j, inliers, total, matches, stacked(one[2] for one in told))

    def _tell(self, end: Pair) -> Told:
        found = self.pair(*end)
        self.told[end] = int(found.verified.count), int(found.verified.total), found.settled
        return self.told[end]


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


def _remembered(cache: OrderedDict, key, most: int, make: Callable):
    if key in cache:
        cache.move_to_end(key)
        return cache[key]
    cache[key] = found = make()
    if len(cache) > most:
        cache.popitem(last=False)
    return found
