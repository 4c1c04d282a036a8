"""What a map's file says at one moment, also while a run is written into it: its paths, its edges, its cameras."""

import dataclasses
import itertools
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ebjax.geometry.planar import between, compose
from ebjax.io.map_file.connection import beside
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.reader import MapReader
from ebjax.io.map_file.rows import Edges, Frames, Keyframes, SessionRow
from ebjax.mapping.looked_by import NAME, LookedBy, looked_by
from ebjax.mapping.sessions import AGAIN, FIRST_STAMP_S, LOG, left_over, of_run
from ebjax.mapping.walk import unpacked_walk
from ebjax.posegraph.graph import PoseGraph, make_graph
from ebjax.slam.path import Path as Walk

STEP, CLOSURE = "step", "closure"
"""Kinds of edges."""
PATH, POSES = "path", "poses"
"""States of a finished session: what its closures corrected, and the poses of all its frames."""
Rows = TypeVar("Rows", Keyframes, Frames, Edges)


@dataclasses.dataclass(frozen=True)
class Track:
    """The frames of a session that are placed, in the order of their numbers.

    Attributes:
      frame: numbers in the session's log.
      stamp_s: s.
      names: of the images.
      poses: x, y (m), heading (rad) in the map.
    """

    frame: Int[np.ndarray, " F"]
    stamp_s: Float[np.ndarray, " F"]
    names: tuple[str, ...]
    poses: Float[np.ndarray, "F 3"]


@dataclasses.dataclass(frozen=True)
class Contents:
    """All of a map but the arrays of its keyframes.

    Attributes:
      sessions: in their order.
      keyframes: with their poses as last solved.
      frames: those between keyframes.
      edges: steps and closures, kept or not.
      looked: of a session what it was looked at with, where that is kept.
      thought_over: of a finished session the poses of all its frames, among themselves.
      walks: of a finished session what its closures corrected.
    """

    sessions: tuple[SessionRow, ...]
    keyframes: Keyframes
    frames: Frames
    edges: Edges
    looked: dict[int, LookedBy]
    thought_over: dict[int, Float[np.ndarray, "F 3"]]
    walks: dict[int, Walk]

    def rows(self, session: int) -> Int[np.ndarray, " n"]:
        """Rows of a session's keyframes."""
        return np.flatnonzero(self.keyframes.session == session)

    def ends(self, edges: Bool[np.ndarray, " E"]) -> Int[np.ndarray, "K 2"]:
        """Rows of the keyframes that some edges join."""
        numbers = np.stack([self.edges.i[edges], self.edges.j[edges]], 1)
        return np.searchsorted(self.keyframes.id, numbers)

    def of_kind(self, kind: str) -> Bool[np.ndarray, " E"]:
        """Which edges are of a kind."""
        return np.array([one == kind for one in self.edges.kind], bool)

    def track(self, session: int) -> Track:
        """The frames of a session, those between keyframes as they were thought over, else as they came."""
        known, frames, rows = self.keyframes, self.frames, self.rows(session)
        mine = np.flatnonzero(np.isin(frames.keyframe, known.id[rows]))
        row = np.searchsorted(known.id, frames.keyframe[mine])
        relative = frames.keyframe_from_base[mine]
        if session in self.thought_over:
            poses = self.thought_over[session]
            relative = between(poses[known.frame[row]], poses[frames.frame[mine]])
        frame = np.concatenate([known.frame[rows], frames.frame[mine]])
        stamp_s = np.concatenate([known.stamp_s[rows], frames.stamp_s[mine]])
        names = [*(known.name[one] for one in rows), *(frames.name[k] for k in mine)]
        poses = np.concatenate([known.pose[rows], compose(known.pose[row], relative)])
        order = np.argsort(frame, kind="stable")
        return Track(frame[order], stamp_s[order], tuple(names[k] for k in order), poses[order])

    def graph(self) -> PoseGraph:
        """Keyframes, their steps and the closures that are kept; steps as they were thought over, else as they came."""
        edges, closure = self.edges, self.of_kind(CLOSURE)
        step = self.of_kind(STEP)
        ends, tables = self.ends(np.ones(len(edges), bool)), []
        for session in self.sessions:
            rows, walk = self.rows(session.id), self.walks.get(session.id)
            if walk is not None and np.array_equal(walk.frames, self.keyframes.frame[rows]):
                found = walk.edges
                tables.append((rows[found.i], rows[found.j], found.measured, found.information))
                step &= ~np.isin(ends[:, 0], rows)
        used = step | (closure & edges.kept)
        tables.append((*ends[used].T, edges.i_from_j[used], np.linalg.inv(edges.covariance[used])))
        i, j, measured, information = (np.concatenate(column) for column in zip(*tables, strict=True))
        robust = np.concatenate([np.zeros(len(i) - int(used.sum()), bool), closure[used]])
        return make_graph(self.keyframes.pose, i, j, measured, information, robust=robust)


def read_contents(kept: MapReader) -> Contents:
    """Reads all that is of one moment, but for attempts of a run that another stands for."""
    with kept.snapshot():
        every = kept.sessions()
        cameras = {one.id: looked_by(kept.state(one.id, NAME)) for one in every if NAME in one.state}
        thought_over = {one.id: kept.state(one.id, POSES)[POSES] for one in every if POSES in one.state}
        walks = {one.id: unpacked_walk(kept.state(one.id, PATH)) for one in every if PATH in one.state}
        keyframes, frames, edges = kept.keyframes(), kept.frames(), kept.edges()
    shown = standing(every)
    ids = [one.id for one in shown]
    mine = keyframes.id[np.isin(keyframes.session, ids)]
    return Contents(
        tuple(shown),
        _some(keyframes, np.isin(keyframes.id, mine)),
        _some(frames, np.isin(frames.keyframe, mine)),
        _some(edges, np.isin(edges.i, mine) & np.isin(edges.j, mine)),
        {number: cameras[number] for number in ids if number in cameras},
        {number: thought_over[number] for number in ids if number in thought_over},
        {number: walks[number] for number in ids if number in walks},
    )


def standing(sessions: list[SessionRow]) -> list[SessionRow]:
    """One session of every run: the finished one, or while there is none the first, which is driven whole."""
    runs = {(one.facts[LOG], one.facts[FIRST_STAMP_S]) for one in sessions if {LOG, FIRST_STAMP_S} <= one.facts.keys()}
    gone = {number for run in runs for number in left_over(of_run(sessions, *run))}
    return [one for one in sessions if one.finished or not (one.facts.get(AGAIN) or one.id in gone)]


def _some(rows: Rows, which: Bool[np.ndarray, " N"]) -> Rows:
    def of(column: Any) -> Any:
        return tuple(itertools.compress(column, which)) if isinstance(column, tuple) else column[which]

    return dataclasses.replace(
        rows, **{field.name: of(getattr(rows, field.name)) for field in dataclasses.fields(rows)}
    )


def open_map_to_read(path: Path) -> MapFile:
    """A map that is only looked at; it is not changed, and another process may go on with it.

    Raises:
      ValueError, OSError: as `MapFile.open`; there is no such file: says how a map is begun.
    """
    if not path.exists():
        raise ValueError(f"{path}: there is no such map; a run begins it: python -m ebjax.slam LOG --map {path}")
    return MapFile.open(path, write=False)


def contents_lines(path: Path, contents: Contents) -> list[str]:
    """What is in a map, a line each."""
    closure = contents.of_kind(CLOSURE)
    kept = closure & contents.edges.kept
    going = [one.id for one in contents.sessions if not one.finished]
    undecided = int(np.isin(contents.keyframes.session[contents.ends(closure)[:, 0]], going).sum())
    megabytes = sum(file.stat().st_size for file in (path, beside(path, "-wal")) if file.exists()) / 1e6
    opposing = int((kept & contents.edges.opposing).sum())
    first = (
        f"{path}: {plural(len(contents.sessions), 'session')}, {plural(len(contents.keyframes), 'keyframe')}, "
        f"{megabytes:.1f} MB, {plural(int(kept.sum()), 'loop closure')} kept ({opposing} from opposing views)"
    )
    if undecided:
        first += f", {plural(undecided, 'candidate')} not decided yet"
    return [first, *(session_line(contents, one) for one in contents.sessions)]


def session_line(contents: Contents, session: SessionRow) -> str:
    """A session in one line."""
    track = contents.track(session.id)
    way = float(np.linalg.norm(np.diff(track.poses[:, :2], axis=0), axis=1).sum())
    state = "finished" if session.finished else "not finished: run the same log with the same --map to go on"
    keyframes = plural(len(contents.rows(session.id)), "keyframe")
    begun = f"begun {session.started}, " if session.started else ""
    return f"session {session.id}, {session.name}: {begun}{keyframes}, {way:.1f} m, {state}"


def plural(count: int, word: str) -> str:
    """1 keyframe, 2 keyframes."""
    return f"{count:,} {word}{'s' * (count != 1)}"
