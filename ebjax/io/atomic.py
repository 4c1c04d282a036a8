"""Outputs are written whole or not at all: into a temporary neighbour first, then renamed into place.

Parent folders are made. Whatever stops the writing (an error, ctrl-C) removes the temporary and leaves the old output
alone; a `resumed_folder` alone keeps it, to go on from.
"""

import contextlib
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any


@contextlib.contextmanager
def whole_file(path: str | Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Opens a temporary neighbour of `path` for writing and renames it to `path` when the block ends well.

    Args:
      path: the file; an existing one is replaced.
      mode: "w" (UTF-8 text, lines end in a newline everywhere) or "wb".

    Raises:
      OSError: the folder cannot be written, the disk is full, or `path` is a folder; names the file.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(21, "is a folder; name a file", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f".{path.name}.{uuid.uuid4().hex[:8]}.partial"
    text: dict[str, str] = {} if "b" in mode else {"encoding": "utf-8", "newline": "\n"}
    try:
        with _told_of(path, temporary):
            with open(temporary, mode.replace("w", "x"), **text) as file:  # type: ignore[call-overload]
                yield file
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Yields a temporary folder whose contents become those of `path` when the block ends well.

    A new folder appears by one rename. Into a folder that exists every file is moved whole, over its namesake;
    other files in it are left alone, so `--out .` never costs anyone a file.

    Args:
      path: the folder.

    Raises:
      OSError: the folder cannot be written, or `path` is a file.
    """
    path = Path(path).absolute()
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(20, "is a file; name a folder", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    # Inside an existing folder, because its parent may be another file system or not ours to write to.
    temporary = (path if path.is_dir() else path.parent) / f".{path.name}.{uuid.uuid4().hex[:8]}.partial"
    try:
        with _told_of(path, temporary):
            temporary.mkdir()
            yield temporary
            if not path.exists():
                temporary.rename(path)
                return
            for source in sorted(p for p in temporary.rglob("*") if not p.is_dir()):
                target = path / source.relative_to(temporary)
                target.parent.mkdir(parents=True, exist_ok=True)
                os.replace(source, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_folder(path: str | Path) -> None:
    """Refuses at once a folder that `whole_folder` could not write after long work; leaves nothing behind.

    Raises:
      OSError: the folder, or the one that it would be made in, cannot be written, or is a file; names it.
    """
    path = Path(path).absolute()
    there = next(one for one in (path, *path.parents) if one.exists())
    if not there.is_dir():
        raise NotADirectoryError(20, "is a file; name a folder", str(there))
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".partial", dir=there):
            pass
    except OSError as fault:
        raise OSError(fault.errno, fault.strerror, str(path)) from None


@contextlib.contextmanager
def resumed_folder(path: str | Path) -> Iterator[Path]:
    """Yields `.NAME.partial` beside `path`, which becomes `path` when the block ends well, else stays for next time.

    What is in it must be written as `whole_file`s: then what is there is whole, even after a kill.

    Args:
      path: a folder that does not exist yet, or is empty.

    Raises:
      OSError: the folder cannot be written, or `path` is there already.
    """
    path = Path(path).absolute()
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise FileExistsError(17, "exists; name another folder", str(path))
    temporary = path.parent / f".{path.name}.partial"
    with _told_of(path, temporary):
        temporary.mkdir(parents=True, exist_ok=True)
        for left in temporary.rglob(".*.partial"):
            left.unlink()
        yield temporary
        temporary.rename(path)


@contextlib.contextmanager
def _told_of(path: Path, temporary: Path) -> Iterator[None]:
    """What fails with the temporary, or does not say with what, as a full disk, is said of the output."""
    try:
        yield
    except OSError as fault:
        name = Path(str(fault.filename))
        if fault.errno and fault.filename is None:
            raise OSError(fault.errno, fault.strerror, str(path)) from None
        if fault.errno and name.is_relative_to(temporary):
            raise OSError(fault.errno, fault.strerror, str(path / name.relative_to(temporary))) from None
        raise
