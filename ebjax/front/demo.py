"""The synthetic corridor that comes without a robot."""

import sys
from pathlib import Path

from ebjax.floors.sequence import CorridorConfig
from ebjax.worlds.render import render_sequence


def demo(folder: str | Path = "runs/demo/sequence") -> Path:
    """Renders a corridor out and back, 91 frames, into a folder, and returns the folder; one that is there is kept.

    Raises:
      ValueError: the folder holds something else.
      OSError: it cannot be written.
    """
    folder = Path(folder)
    if not (folder / "rgb.txt").is_file():
        print(f"rendering a synthetic corridor into {folder}", file=sys.stderr)
        render_sequence(CorridorConfig(), folder)
    return folder
