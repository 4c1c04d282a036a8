"""A map described anew from its floor views, where weights, words, descriptor or extractor change, as a new file.

Every keyframe is described from its view and looked for among those before it, as the engine does while a robot drives;
at the end of a session its closures are decided as at the end of a run. What was measured on the way stays: the path of
every run as it was settled, steps, clocks and mounts.

The map itself is only read. A stop at any moment loses nothing: NAME.redescribed.partial is gone on with.
"""

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from ebjax.io.map_file.connection import beside
from ebjax.io.map_file.faults import Damaged
from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.lock import WriterLock
from ebjax.io.map_file.reader import OF_MAP
from ebjax.io.map_file.repair import named
from ebjax.io.map_file.rows import Arrays, EdgeRow, FrameRow, SessionRow
from ebjax.mapping.agreement import DESCRIBED_BY, LOOKED_UP_BY, described_with, disagreeing, with_settings
from ebjax.mapping.contents import CLOSURE, PATH, POSES, STEP, Contents, open_map_to_read, plural, read_contents
from ebjax.mapping.looked_by import NAME
from ebjax.mapping.rows import closure_rows, keyframe_row, step_row
from ebjax.mapping.sessions import AGREES
from ebjax.mapping.shelf import MEASURED, MapShelf
from ebjax.mapping.still_map import camera_and_view
from ebjax.mapping.walk import unpacked_walk
from ebjax.places.descriptor import descriptor
from ebjax.places.place import placing
from ebjax.slam.close import close
from ebjax.slam.config import PipelineConfig
from ebjax.slam.engine import Engine
from ebjax.slam.look_again import look_again
from ebjax.slam.store import Between
from ebjax.viz.ticker import LiveLine, PlainLines, ticker

SOURCE = "redescribes"
"""State of the new map: what it is made of, and how."""
WAY = ("at.", "follow.", "steps.")
"""How the names begin of what was measured on the way."""


def redescribe(path: str | Path, config: PipelineConfig) -> list[str]:
    """Writes NAME.redescribed.ebmap beside a map; returns what was done, a line each.

    Args:
      path: of the map.
      config: descriptor, extractor, weights, arithmetic and ranking to describe with; everything else is as each
        session was driven.

    Raises:
      ValueError: no map, or a damaged one; its views were dropped; the descriptor looks at more than the floor; there
        are no weights or words.
      OSError: the new file is there already or cannot be written; another process writes to the map.
    """
    path = Path(path)
    out = path.with_name(f"{path.stem}.redescribed{path.suffix}")
    partial = out.with_suffix(".partial")
    with open_map_to_read(path) as old, WriterLock(old.path):
        if out.exists():
            raise FileExistsError(errno.EEXIST, "is there already; remove it, or give it another name", str(out))
        if descriptor(config.descriptor, config.weights, config.arithmetic).whole_image:
            raise ValueError(
                f"--descriptor {config.descriptor} looks at the whole image, and a map keeps the floor alone; give "
                "another --descriptor"
            )
        now, contents = described_with(config), read_contents(old)
        same = disagreeing(old.facts, now) is None
        source = _Source(old, contents, config, now)
        source.check()
        with _begun(partial, source) as new, ticker(len(contents.keyframes)) as ticking:
            before = len(new.keyframes())
            for session in contents.sessions:
                source.session(new, session, ticking)
            after = read_contents(new)
            stopped = beside(new.path, "-wal")
        if stopped.exists():
            raise OSError(f"{partial}: another program reads it; close that, and run the same command again")
        lines = [*_told(path, out, contents, after, same, before), *old.notes, f"go on with --map {out}"]
        os.replace(partial, out)
    return lines


class _Source:
    """A map that is described anew, and how."""

    def __init__(self, old: MapFile, contents: Contents, config: PipelineConfig, described: dict[str, Any]):
        self.old, self.contents, self.config, self.described = old, contents, config, described
        self._place = placing(config.descriptor, config.weights)
        frames = contents.frames
        self._frames: dict[int, list[FrameRow]] = {}
        for k, keyframe in enumerate(frames.keyframe.tolist()):
            row = int(frames.frame[k]), float(frames.stamp_s[k]), frames.name[k], keyframe, frames.keyframe_from_base[k]
            self._frames.setdefault(keyframe, []).append(FrameRow(*row))
        steps = np.flatnonzero(contents.of_kind(STEP))
        self._steps = dict(zip(contents.edges.i[steps].tolist(), steps.tolist(), strict=True))
        self._names = dict(zip(contents.keyframes.id.tolist(), contents.keyframes.name, strict=True))

    def check(self) -> None:
        """Refuses a map that does not keep what is needed."""
        path = self.old.path
        for one in self.contents.sessions:
            forget = f"forget it: --map {path} --forget {one.id}"
            if one.id not in self.contents.looked:
                raise ValueError(f"{path}: does not say what session {one.id} was looked at with; {forget}")
            for number in self.numbers(one).tolist():
                with contextlib.suppress(Damaged):
                    if "view" not in self.old.arrays(number):
                        raise ValueError(
                            f"{path}: the floor views of session {one.id} were dropped (--no-views), and nothing else "
                            f"can be described anew; drive its log into another map, or {forget}"
                        )
                    break

    def digest(self) -> str:
        """Of the map as it is now, and of what it is described with."""
        sessions = [[one.id, one.name, one.finished, one.facts] for one in self.contents.sessions]
        how = [self.described, *(getattr(self.config, name) for name in LOOKED_UP_BY)]
        whole = json.dumps([sessions, self.contents.keyframes.id.tolist(), how], sort_keys=True)
        return hashlib.sha256(whole.encode()).hexdigest()

    def facts(self) -> dict[str, Any]:
        """Of the new map."""
        return self._anew(self.old.facts)

    def _anew(self, facts: Mapping[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in facts.items() if name not in DESCRIBED_BY} | self.described

    def numbers(self, session: SessionRow) -> Int[np.ndarray, " n"]:
        """The keyframes of a session."""
        return self.contents.keyframes.id[self.contents.rows(session.id)]

    def session(self, new: MapFile, session: SessionRow, ticking: PlainLines | LiveLine) -> None:
        """Describes a session anew, or the rest of it."""
        begun = {one.id: one for one in new.sessions()}
        if session.id not in begun:
            new.take_session(dataclasses.replace(session, facts=self._session_facts(session)))
        elif begun[session.id].finished:
            return
        new.put_state(session.id, NAME, self.old.state(session.id, NAME))
        shelf = _Anew(self, new, next(one for one in new.sessions() if one.id == session.id))
        camera, view = camera_and_view(self.contents.looked[session.id])
        config = with_settings(self.config, session.facts.get(AGREES, {}))
        engine = Engine(camera, config, view=view, store=shelf)
        done = new.keyframes(session.id).id
        for number in self.numbers(session).tolist():
            if number > done.max(initial=-1):
                started, shelf.next = time.perf_counter(), number
                self._keyframe(number, engine, shelf)
                spent_ms, count = 1e3 * (time.perf_counter() - started), len(shelf)
                row = int(np.searchsorted(self.contents.keyframes.id, number))
                ticking.update(row, count, int(engine.belief.kept.sum()), spent_ms)
        if not session.finished:
            return
        walk = self.old.state(session.id, PATH)
        if not walk or not len(engine.numbers):  # a repair did not save it
            return new.end_session(session.id)
        path = unpacked_walk(walk)
        closed = close(engine, path, engine.measured())
        measured = bool(self.old.state(session.id, POSES).get(MEASURED, False))
        shelf.conclude(closed.earlier, path, closed.poses, measured=measured)

    def _session_facts(self, session: SessionRow) -> dict[str, Any]:
        if AGREES not in session.facts:
            return session.facts
        looked_up = {f"--{name}": getattr(self.config, name) for name in LOOKED_UP_BY}
        return session.facts | {AGREES: self._anew(session.facts[AGREES]) | looked_up}

    def _keyframe(self, number: int, engine: Engine, shelf: "_Anew") -> None:
        try:
            kept = self.old.arrays(number)
        except Damaged:
            return
        if "view" not in kept:
            raise ValueError(f"{self.old.path}: the floor view of keyframe {number} was dropped (--no-views)")
        way = {name: array for name, array in shelf.as_rows(kept, number).items() if name.startswith(WAY)}
        engine.recognise(way | look_again(kept, engine.eyes, self._place), self._names[number])

    def step(self, number: int, before: int) -> EdgeRow | None:
        """The step to a keyframe from the one before; None where there was none between these."""
        edges, k = self.contents.edges, self._steps.get(number)
        if k is None or edges.j[k] != before:
            return None
        return edges.row(k)

    def frames(self, keyframe: int) -> list[FrameRow]:
        """The frames that a keyframe places."""
        return self._frames.get(keyframe, [])


class _Anew(MapShelf):
    """A session of the new map.

    Attributes:
      next: the number of the next keyframe, as in the map that is described anew.
    """

    def __init__(self, source: _Source, file: MapFile, session: SessionRow):
        super().__init__(file, session)
        self.next, self._source = 0, source

    def keep(self, kept: Arrays, name: str = "", between: Sequence[Between] = ()) -> None:
        """Adds a keyframe with the step to it and the frames that it places as they were, and its new candidates."""
        number, row, source = self.next, len(self) - 1, self._source
        whole, edges = self.numbered(kept, number), []
        if row >= 0 and self.piece(row) == self.current:
            before = self.number(row)
            # To one whose neighbour is lost the step is what the path says.
            edges = [source.step(number, before) or step_row(number, before, self.arrays(row)["at.pose"], whole)]
        keyframe = keyframe_row(number, self.current, name, whole)
        self.add(keyframe, whole, edges + closure_rows(number, whole), source.frames(number))


@contextlib.contextmanager
def _begun(partial: Path, source: _Source) -> Iterator[MapFile]:
    """The new map, or what there is of it."""
    begun = partial.exists()
    digest = {"digest": np.array(source.digest())}
    with MapFile.open(partial, write=True) if begun else MapFile.create(partial, source.facts()) as new:
        if new.sessions() and str(new.state(OF_MAP, SOURCE).get("digest")) != source.digest():
            raise ValueError(
                f"{partial}: was begun from another state of {source.old.path.name}, or with other flags; remove it to "
                "begin anew"
            )
        new.put_state(OF_MAP, SOURCE, digest)
        yield new


def _told(path: Path, out: Path, was: Contents, now: Contents, same: bool, before: int) -> list[str]:
    """What was done."""
    found, kept = _kept(now), _kept(was)
    count = len(now.keyframes)
    lines = [
        f"{path}: described {plural(count, 'keyframe')} of {plural(len(now.sessions), 'session')} anew; it kept "
        f"{plural(len(kept), 'closure')} and keeps {len(found)} now, {len(kept & found)} between the same keyframes"
    ]
    if before:
        lines.append(f"{out.with_suffix('.partial')}: was gone on with after {plural(before, 'keyframe')}")
    if same:
        lines.append("extractor, descriptor, weights and words are what they were: what changed is what JPEG changed")
    lost = set(was.keyframes.id.tolist()) - set(now.keyframes.id.tolist())
    if lost:
        lines.append(f"lost: {named('keyframe', lost)}, whose arrays are damaged")
    for one in now.sessions:
        if one.finished and PATH not in one.state and len(now.rows(one.id)):
            lines.append(f"{out}: session {one.id} does not say its path: the next run decides about its closures")
    return lines


def _kept(contents: Contents) -> set[tuple[int, int, bool]]:
    edges, closures = contents.edges, np.flatnonzero(contents.of_kind(CLOSURE) & contents.edges.kept)
    return set(zip(*(column[closures].tolist() for column in (edges.i, edges.j, edges.opposing)), strict=True))
