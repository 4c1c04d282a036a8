"""What a user does with a whole map: forget a session, drop the views, save what is left of a damaged one.

Each returns what it did, a line each.
"""

from pathlib import Path

import numpy as np

from ebjax.io.map_file.file import MapFile
from ebjax.io.map_file.repair import repair
from ebjax.mapping.contents import plural

VIEW = "view"
"""The array of a keyframe that is its floor view in colour."""


def forget(path: str | Path, session: int) -> list[str]:
    """Removes a session with its keyframes and every closure that touches one.

    Raises:
      ValueError: no map, or no such session: names those that there are.
      OSError: another process writes to it, or it cannot be written.
    """
    with MapFile.open(path, write=True) as file:
        count, before = len(file.keyframes(session)), file.path.stat().st_size
        name = next((one.name for one in file.sessions() if one.id == session), "")
        file.forget(session)
        notes = file.notes
    return [f"{path}: forgot session {session}, {name}: {plural(count, 'keyframe')}, {_saved(path, before)}", *notes]


def drop_views(path: str | Path) -> list[str]:
    """Drops the floor views in colour of finished sessions; what loops are closed with stays, a grey picture too.

    Raises:
      ValueError, OSError: as `forget`.
    """
    with MapFile.open(path, write=True) as file:
        keyframes, before = file.keyframes(), file.path.stat().st_size
        unfinished = [one.id for one in file.sessions() if not one.finished]
        kept = set(keyframes.id[np.isin(keyframes.session, unfinished)].tolist())

        def without(number: int, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray] | None:
            if number in kept or VIEW not in arrays:
                return None
            return {name: array for name, array in arrays.items() if name != VIEW}

        count = file.change_arrays(without)
        notes = file.notes
    lines = [f"{path}: dropped the colour views of {plural(count, 'keyframe')}, {_saved(path, before)}", *notes]
    if unfinished:
        names = ", ".join(map(str, unfinished))
        lines.append(f"{path}: kept those of unfinished sessions ({names}): finish or forget them first")
    return lines


def repaired(path: str | Path, out: str | Path | None = None) -> list[str]:
    """Saves what can be read of a map into a new file, NAME.repaired.ebmap beside it where `out` is None.

    Raises:
      ValueError: nothing of a map is in the file.
      OSError: `out` is there already, or a process writes to the map.
    """
    path = Path(path)
    report = repair(path, path.with_name(f"{path.stem}.repaired{path.suffix}") if out is None else out)
    return [report.summary(), *(f"lost: {line}" for line in report.lost), f"go on with --map {report.out}"]


def _saved(path: str | Path, before: int) -> str:
    return f"{max(before - Path(path).stat().st_size, 0) / 1e6:.1f} MB less"
