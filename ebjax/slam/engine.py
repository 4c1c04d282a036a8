"""The engine: a run frame by frame, each step from what is past.

    frame -> keyframe? -> describe -> steps to the keyframes before -> places alike -> verify -> believe -> correct

What decides are measurements and the path of their steps.
"""

import dataclasses
import time
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt8

from ebjax.features.extractor import unturned
from ebjax.features.verify_pairs import stacked
from ebjax.geometry.planar import compose, inverse
from ebjax.odometry.floor_steps import more_certain
from ebjax.odometry.image_corners import compile_lifting
from ebjax.places.descriptor import descriptor
from ebjax.places.fixed_words import FixedWords, fixed_words
from ebjax.places.index import Comparable, PlaceIndex
from ebjax.places.place import Place
from ebjax.places.search import check_ranking
from ebjax.posegraph.graph import PoseGraph
from ebjax.slam.believe import Belief
from ebjax.slam.compared import compile_comparing
from ebjax.slam.config import PipelineConfig
from ebjax.slam.correct import Begin, Corrector
from ebjax.slam.frame import Closure, Frame, Update
from ebjax.slam.graph import graph_so_far
from ebjax.slam.join import joined
from ebjax.slam.measured import Measured
from ebjax.slam.packed import Arrays, place_of
from ebjax.slam.recall import Alike, comparable_rows, filled, not_ranked, worth_verifying
from ebjax.slam.table import Table
from ebjax.slam.told import packed_pairs, packed_steps, unpacked_pairs, unpacked_steps
from ebjax.slam.walked import Walked
from ebjax.slam.walker import Walker


class Engine(Walker):
    """Closes loops as the robot drives.

    Attributes:
      candidates: earlier keyframes that were verified, measured; rows of the keyframes.
      belief: which of them are closures, and why the others are not.
      firsts: of every keyframe the one that looks most alike.
      corrector: where the keyframes are after the closures.
      seconds: of each stage.
    """

    def __init__(self, *given: Any, **options: Any):
        """See `ebjax.slam.mapper.Mapper`."""
        super().__init__(*given, **options)
        words = correlating(self.config)
        self.index = PlaceIndex() if words is None else PlaceIndex(words, self._maps)
        self.firsts = Table(j=int, opposing=bool, distance=float)
        self.candidates = Table(
            i=int, j=int, opposing=bool, distance=float, inliers=int, total=int, i_from_j=(float, (3,)),
            covariance=(float, (3, 3)),
        )  # fmt: skip
        self.belief = Belief(self.config.believe)
        self.corrector = Corrector(None if self.recording is None else self.start + len(self.recording))
        self.seconds: dict[str, float] = {}
        for row in range(len(self.store)):
            self._take_up(row, self.store.arrays(row))
        if len(self.candidates):
            self.belief.update(self.measured(), self.path)

    def add(self, frame: Frame) -> Update:
        """Takes the next frame.

        Raises:
          ValueError: as of `Walker.due`.
          OSError: the keyframe cannot be kept.
        """
        begun = time.perf_counter()
        number, due = self.due(frame)
        closures: tuple[Closure, ...] = ()
        path = None
        for one, kept in due:
            news, corrected = self._keyframe(one, kept)
            closures += news
            path = self.corrector.poses(self.chain.poses) if corrected else path
        update = self._update(frame, number, bool(due), closures, path, begun)
        self.passed(frame, number, any(one == number for one, _ in due))
        return update

    def _keyframe(self, number: int, kept: Arrays) -> tuple[tuple[Closure, ...], bool]:
        row = self._arrived(number, kept)
        if row == self.start:
            self._ahead.spare(partial(self._compile, kept))
        news = self._recognise(row, kept)
        self._keep(row, number)
        return news, self.corrector.take(row + 1, self._graph, self.chain.poses)

    def _compile(self, kept: Arrays) -> None:
        """Makes the programs of the first turn and the first closures, so that none of these has to wait for them."""
        self.looked.compile_facing(kept)
        compile_comparing()
        if self.config.motion != "wheels":
            compile_lifting(self.camera)

    def _recognise(self, row: int, kept: Arrays) -> tuple[Closure, ...]:
        """Looks for a keyframe among those before; returns closures whose standing is new."""
        place, path, config, view = place_of(kept), self.path, self.config, self.view
        comparable = comparable_rows(
            self.keyframes.stamp_s, self.keyframes.travelled, self.start, config.min_gap_s, config.min_gap_m
        )
        alike = self._alike(place, *comparable)
        first = (alike.j[0], alike.opposing[0], alike.distance[0]) if len(alike.j) else (-1, False, np.inf)
        self.firsts.append(j=first[0], opposing=first[1], distance=first[2])
        either_way = self.eyes.extractor.turn is unturned
        chosen = worth_verifying(alike, row, path, view, config, either_way)
        others = not_ranked(chosen, row, comparable, path, view, config)
        if any(mask.any() for mask in others):
            chosen = filled(chosen, self._alike(place, *others), config.verify)
        self.index.add(place)
        return self._believe(row, chosen, path)

    def recognise(self, kept: Arrays, name: str) -> None:
        """Looks for a keyframe whose way is known (`at.*`) among those before, and keeps it.

        Raises:
          OSError: the keyframe cannot be kept.
        """
        row, self.store.newest = len(self.store), kept
        self._hang(row, kept)
        self._recognise(row, kept)
        self.store.keep({**kept, **self._found(row)}, name, [])

    def _maps(self, rows: Int[np.ndarray, " K"]) -> tuple[Int8[np.ndarray, "K h w D"], UInt8[np.ndarray, "K h w"]]:
        kept = [self.store.arrays(int(row)) for row in rows]
        return np.stack([k["place.map"] for k in kept]), np.stack([k["place.weight"] for k in kept])

    def _alike(self, place: Place, same: Comparable, opposing: Comparable) -> Alike:
        found = self.index.query(place, same, opposing)
        return Alike(np.asarray(found.j), np.asarray(found.opposing), np.asarray(found.distance))

    def _believe(self, row: int, chosen: Alike, path: Walked) -> tuple[Closure, ...]:
        count = len(self.candidates)
        if len(chosen.j):
            i = np.full(len(chosen.j), row)
            self.looked.pairs(i, chosen.j, chosen.opposing)
            for j, opposing, distance in zip(chosen.j, chosen.opposing, chosen.distance, strict=True):
                self._candidate(row, int(j), bool(opposing), float(distance))
            before = self.belief.kept.copy()
            self.belief.update(self.measured(), path)
            changed = np.flatnonzero(before != self.belief.kept[:count])
            return tuple(self._closure(int(k)) for k in [*changed, *range(count, len(self.candidates))])
        return ()

    def _candidate(self, row: int, j: int, opposing: bool, distance: float) -> None:
        told = self.looked.told[row][j, opposing]
        i_from_j, covariance, _ = more_certain(stacked([told.settled]), False)
        self.candidates.append(
            i=row, j=j, opposing=opposing, distance=distance, inliers=told.inliers, total=told.total,
            i_from_j=i_from_j[0], covariance=covariance[0],
        )  # fmt: skip

    def measured(self) -> Measured:
        """All candidates so far; i and j are rows of the keyframes."""
        return Measured(*(getattr(self.candidates, field.name) for field in dataclasses.fields(Measured)))

    def _closure(self, k: int) -> Closure:
        c, frame = self.candidates, self.keyframes.frame
        reason = str(self.belief.reasons[k])
        ends = int(frame[c.i[k]]), int(frame[c.j[k]])
        rows = int(c.i[k]), int(c.j[k])
        return Closure(*ends, bool(c.opposing[k]), c.i_from_j[k].copy(), bool(self.belief.kept[k]), reason, rows)

    def _graph(self) -> Begin:
        kept = self.measured().rows(np.flatnonzero(self.belief.kept))
        walked = self.chain.poses.copy(), self.chain.covariance.copy(), self.keyframes.piece.copy()

        def made(poses: Float[np.ndarray, "N 3"]) -> tuple[PoseGraph, Bool[np.ndarray, " N"]]:
            start, in_map = joined(poses, walked[-1], kept)
            return graph_so_far(*walked, start, kept), in_map

        return made

    def _update(self, frame: Frame, number: int, keyframe: bool, closures, path, begun: float) -> Update:
        rows = len(self.chain)
        pose, covariance = np.zeros(3), np.eye(3)
        if rows > self.start:
            pose = compose(self.corrector.last(self.chain.poses), self._from_keyframe())
            covariance = self.chain.spread_since(max(self.corrector.settled - 1, 0))
        odom = frame.odom_from_base
        return Update(
            number,
            frame.stamp_s,
            rows - 1 if keyframe else None,
            pose,
            not self.start or self.corrector.in_map(self.start),
            None if odom is None else compose(pose, inverse(np.asarray(odom, float))),
            covariance,
            closures,
            path,
            self.looked.seen(rows - 1) if keyframe else None,
            1e3 * (time.perf_counter() - begun),
        )

    def _keep(self, row: int, number: int) -> None:
        """Keeps the keyframe in work with all that was measured of it."""
        keyframes = self.keyframes
        bridged = self._steps.kind == "image"
        steps = self._steps.rows(bridged | (self._steps.kind == "rotation"))
        if len(steps.i):
            self.bridged.append(steps)
        told = {
            "at.frame": np.array(number),
            "at.stamp_s": np.array(keyframes.stamp_s[row]),
            "at.odom": keyframes.odom[row].copy(),
            "at.travelled": np.array(keyframes.travelled[row]),
            "at.pose": self.chain.poses[row].copy(),
            "at.step": self.chain.steps[row].copy(),
            "at.measured": np.array(self.chain.measured[row]),
        }
        if self.follower is not None:
            told |= self.follower.told_up_to(number)
        whole = {**self.store.newest, **told, **self._found(row), **packed_steps(steps)}
        between, self._between = [one for one in self._between if one.frame < number], []
        self.store.keep(whole, self.names[number], between)

    def _found(self, row: int) -> dict[str, np.ndarray]:
        """What a keyframe was compared with, and what came out."""
        firsts, mine = self.firsts, self.candidates.i == row
        return {
            "first": np.array([firsts.j[row], firsts.opposing[row], firsts.distance[row]]),
            "candidates": np.stack([self.candidates.j[mine], self.candidates.opposing[mine]], 1).astype(np.int64),
            "candidates.distance": self.candidates.distance[mine].copy(),
            **packed_pairs(self.looked.told[row]),
        }

    def _hang(self, row: int, kept: Arrays) -> bool:
        """Hangs a keyframe on the path where it was; returns whether it is of this run."""
        number, odom, piece = int(kept["at.frame"]), kept["at.odom"], self.store.piece(row)
        mine = row >= self.start
        if mine != (piece == self.store.current):
            raise ValueError(f"keyframe {row} of an earlier run lies among those of the one that goes on")
        self.keyframes.append(
            frame=number, stamp_s=kept["at.stamp_s"], odom=odom, travelled=kept["at.travelled"], piece=piece
        )  # fmt: skip
        pose, step = (kept["at.pose"], kept["at.step"]) if mine else self.store.settled_step(row, kept)
        self.chain.take_up(float(kept["at.stamp_s"]), pose, step, bool(kept["at.measured"]))
        return mine

    def _take_up(self, row: int, kept: Arrays) -> None:
        """Goes on from a keyframe that was kept."""
        mine, first = self._hang(row, kept), kept["first"]
        if mine and self.follower is None and "follow.frames" in kept:
            self._follow()
        self.firsts.append(j=int(first[0]), opposing=bool(first[1]), distance=first[2])
        self.index.add(place_of(kept))
        self.looked.told[row] = unpacked_pairs(kept)
        if mine and len(kept["steps.words"]):
            self.bridged.append(unpacked_steps(kept))
        for (j, opposing), distance in zip(kept["candidates"].tolist(), kept["candidates.distance"], strict=True):
            self._candidate(row, j, bool(opposing), float(distance))
        if mine and self.follower is not None:
            self.follower.take_up(int(kept["at.frame"]), float(kept["at.stamp_s"]), kept)
        elif mine:
            self._asked = kept["at.odom"].copy()


def correlating(config: PipelineConfig) -> FixedWords | None:
    """The words whose maps are correlated; None where places are ranked by cosine alone.

    Raises:
      ValueError: maps are to be correlated and the descriptor has none.
    """
    place = descriptor(config.descriptor, config.weights, config.arithmetic)
    check_ranking(config.ranking, place.has_maps)
    if config.ranking == "cosine" or not place.has_maps:
        return None
    name = "floornet" if config.descriptor == "joint" else config.descriptor
    return fixed_words(name, config.weights)
