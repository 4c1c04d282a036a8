"""What was measured, on disk cell by cell: a run that was killed goes on, what is damaged or outdated is made anew.

    FOLDER/NAME.json         {"settings", "values", "check"}: check is the digest of the other two
    PICTURE.png              beside it FOLDER/PICTURE.json with the settings and the digest of the picture

Every file appears whole. A cell counts when its digest is right and its settings are those asked for.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ebjax.io.atomic import whole_file

Values = Mapping[str, Any]


def _text(values: Any) -> str:
    return json.dumps(values, sort_keys=True, allow_nan=False)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def weighed(weights: Path | None) -> dict[str, Any]:
    """A weights file, by size and time, as part of a cell's settings."""
    return {} if weights is None else {"weights": [weights.name, weights.stat().st_size, weights.stat().st_mtime]}


class Cells:
    """A folder of cells.

    Attributes:
      folder: where they are.
      damaged: files that were found damaged and made again.
      measured: how many were measured by this process.
      reused: how many were found.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self.damaged: list[Path] = []
        self.measured = self.reused = 0

    def _path(self, name: str) -> Path:
        return self.folder / f"{re.sub(r'[^A-Za-z0-9.]+', '_', name)}.json"

    def _read(self, path: Path, settings: Values) -> Any:
        """The values of a cell; None where there is none, or not of these settings."""
        if not path.exists():
            return None
        try:
            found = json.loads(path.read_bytes())
            whole = found["check"] == _digest(_text([found["settings"], found["values"]]).encode())
        except (ValueError, KeyError, TypeError):
            whole = False
        if not whole:
            self.damaged.append(path)
            return None
        return found["values"] if found["settings"] == json.loads(_text(settings)) else None

    def _write(self, path: Path, settings: Values, values: Any) -> Any:
        # Through JSON, so that a cell is the same when it is measured and when it is found; the order is kept.
        settings, values = (json.loads(json.dumps(part, allow_nan=False)) for part in (settings, values))
        check = _digest(_text([settings, values]).encode())
        with whole_file(path) as file:
            json.dump({"settings": settings, "values": values, "check": check}, file, allow_nan=False)
        return values

    def values(self, name: str, settings: Values, measure: Callable[[], Values]) -> dict[str, Any]:
        """The cell's values, measured and kept if it is not there.

        Args:
          name: of the cell; letters, digits and dots of it make the file's name.
          settings: all that the values depend on; plain values.
          measure: gives plain values without NaN.
        """
        path = self._path(name)
        found = self._read(path, settings)
        if found is None:
            found = self._write(path, settings, measure())
            self.measured += 1
        else:
            self.reused += 1
        return found

    def picture(self, path: Path, settings: Values, draw: Callable[[], bytes]) -> Path:
        """A PNG at `path`, drawn if it is not there, damaged, or drawn with other settings."""
        record = self._path(path.name)
        found = self._read(record, settings)
        if found is not None and path.is_file():
            if _digest(path.read_bytes()) == found["picture"]:
                self.reused += 1
                return path
            self.damaged.append(path)
        png = draw()
        with whole_file(path, "wb") as file:
            file.write(png)
        self._write(record, settings, {"picture": _digest(png)})
        self.measured += 1
        return path
