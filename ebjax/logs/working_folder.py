"""The hidden folder beside the one that is asked for, where a long writing goes on after an interruption."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

STATE = "state.json"


def source_state(path: Path) -> dict[str, Any]:
    """What tells whether a file or folder is still the same: its place, size and latest change."""
    files = [path] if path.is_file() else [Path(at) / name for at, _, names in os.walk(path) for name in names]
    stats = [file.stat() for file in files]
    return {
        "path": str(path.resolve()),
        "files": len(stats),
        "bytes": sum(stat.st_size for stat in stats),
        "changed_ns": max((stat.st_mtime_ns for stat in stats), default=0),
    }


def working_folder(out: Path, state: dict[str, Any]) -> tuple[Path, str | None]:
    """The unfinished folder of `out`, made if there is none of this state.

    Args:
      out: the folder that is asked for.
      state: what it is made from, as JSON has it; one of another state is removed.

    Returns:
      The folder, and what was found, to say; None where it is new.
    """
    folder = out.absolute().parent / f".{out.absolute().name}.partial"
    found = None
    if folder.exists():
        if _state(folder) == json.loads(json.dumps(state)):
            return folder, f"{out}: goes on where the last call stopped"
        shutil.rmtree(folder)
        found = f"{out}: what an earlier call began, of another log or with other options, is removed; starts anew"
    folder.mkdir(parents=True)
    put(folder / STATE, json.dumps(state, indent=1).encode())
    return folder, found


def finish(folder: Path, out: Path) -> None:
    """Gives the whole folder its name."""
    (folder / STATE).unlink()
    for part in folder.rglob(".*.part"):
        part.unlink()
    folder.rename(out.absolute())


def put(path: Path, content: bytes) -> None:
    """Writes a file, whole: one that stands there by its name is never cut off."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(content)
    except OSError as fault:  # a full disk does not say which file it was
        raise OSError(fault.errno, fault.strerror, str(path)) from None
    os.replace(part, path)


def _state(folder: Path) -> Any:
    try:
        return json.loads((folder / STATE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
