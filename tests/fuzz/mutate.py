"""Makes the n-th damaged input of a reader from its seeds: a pure function of (seed, reader, n)."""

import gzip
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .containers import change_inside
from .damage import BYTES, TEXT, is_text, splice
from .trees import change_tree, is_tree

BOMB = gzip.compress(bytes(1 << 20), mtime=0) * 1200
"""1.2 MB that unpack to as many GB."""


@dataclass(frozen=True)
class Input:
    """What a reader is given.

    Attributes:
      files: name -> content; None is a folder in the place of a file.
      target: the name that the reader is given; "" is the folder of them all.
    """

    files: Mapping[str, bytes | None]
    target: str

    def write(self, folder: Path) -> Path:
        """Writes the files; returns the path for the reader."""
        folder.mkdir(parents=True)
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if content is None:
                path.mkdir(exist_ok=True)
            else:
                path.write_bytes(content)
        return folder / self.target


def input_from(path: Path, target: str | None = None) -> Input:
    """The input of a file, or of a folder with all that is in it."""
    if path.is_file():
        return Input({path.name: path.read_bytes()}, path.name)
    files = {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}
    return Input(files, target or "")


def mutated(reader: str, seeds: Sequence[Input], seed: int, number: int) -> Input:
    """The input `number` of a campaign: a seed with one to four mutations."""
    draw = random.Random(f"{seed} {reader} {number}")
    chosen, other = draw.choice(seeds), draw.choice(seeds)
    files = dict(chosen.files)
    for _ in range(draw.choice((1, 1, 1, 2, 2, 4))):
        name = draw.choice(sorted(files))
        if len(files) > 1 and draw.random() < 0.15:
            _change_names(files, name, draw)
            if not files:
                break
        elif (content := files[name]) is not None:
            files[name] = _changed(content, other, draw)
    if chosen.target and chosen.target not in files:
        files[chosen.target] = None
    return Input(files, chosen.target)


def _change_names(files: dict[str, bytes | None], name: str, draw: random.Random) -> None:
    """A file is missing, is a folder, has another's content, or another name."""
    how = draw.randrange(4)
    if how == 0:
        del files[name]
    elif how == 1:
        files[name] = None
    elif how == 2:
        files[name] = files[draw.choice(sorted(files))]
    elif not name.endswith("x"):
        files[f"{name}x"] = files.pop(name)


def _changed(content: bytes, other: Input, draw: random.Random) -> bytes | None:
    kind = draw.random()
    if kind < 0.01:
        return None
    if kind < 0.012:
        return BOMB
    if kind < 0.06:
        there = [part for part in other.files.values() if part is not None]
        return splice(content, draw.choice(there), draw) if there else content
    if kind < 0.08:
        return gzip.compress(content, mtime=0)[: draw.choice((-1, 5, None))]
    if kind < 0.6:
        return change_inside(content, draw, lambda inner: _plain(inner, draw))
    return _plain(content, draw)


def _plain(content: bytes, draw: random.Random) -> bytes:
    if is_text(content) and content:
        if draw.random() < 0.4 and is_tree(content):
            return change_tree(content, draw)
        if draw.random() < 0.7:
            return draw.choice(TEXT)(content, draw)
    return draw.choice(BYTES)(content, draw)
