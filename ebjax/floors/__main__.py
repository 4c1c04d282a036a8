"""Renders synthetic floors: a robot's run in TUM layout and as a ROS bag, or a contact sheet of all floors."""

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2

from ebjax.command import run
from ebjax.io.atomic import whole_file
from ebjax.io.write_bag import BagKind
from ebjax.worlds.render import IMAGES, Config, render_sequence


def main(config: Config) -> None:
    """Renders and says what was written."""
    bag: BagKind | None = None if config.format == "tum" else config.format
    render_sequence(config, config.out, bag, resume=config.resume)
    more = "" if bag is None else f", run.{bag}"
    print(f"{config.out}: rgb.txt, depth.txt, odometry.txt, groundtruth.txt, camera.json, world.yaml{more}")


@dataclasses.dataclass(frozen=True)
class SheetConfig:
    """Draws every family of floor: from above, and as two robots see it that face each other."""

    out: Path = Path("runs/floors.png")
    """PNG or JPEG file."""
    seed: int = 0
    """Everything random follows from it."""


def draw_sheet(config: SheetConfig) -> None:
    """Draws and writes the sheet."""
    from ebjax.floors.sheet import sheet

    if config.out.suffix.lower() not in IMAGES:
        raise ValueError(f"--out is {config.out}: name a .png or .jpg file")
    image = cv2.cvtColor(sheet(config.seed), cv2.COLOR_RGB2BGR)
    options = [] if config.out.suffix.lower() == ".png" else [cv2.IMWRITE_JPEG_QUALITY, 85]
    done, content = cv2.imencode(config.out.suffix, image, options)
    assert done
    with whole_file(config.out, "wb") as file:
        file.write(content.tobytes())
    print(f"wrote {config.out}")


COMMANDS: dict[str, tuple[Callable[[Any], None], type]] = {"sheet": (draw_sheet, SheetConfig)}

if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in COMMANDS:
        run(*COMMANDS[sys.argv[1]], sys.argv[2:])
    else:
        run(main, Config)
