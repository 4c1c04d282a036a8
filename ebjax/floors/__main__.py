"""Renders synthetic floors: a robot's run in TUM layout and as a ROS bag, or a contact sheet of all floors."""

import dataclasses
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Float

from ebjax.command import dump_config, progress, run
from ebjax.config import load_config
from ebjax.floors.sensor import GAMMA
from ebjax.floors.sequence import CorridorConfig, Recording, record
from ebjax.io.calibration.read import read_calibration
from ebjax.io.camera_file import CameraFile
from ebjax.io.images import read_image
from ebjax.io.write_bag import BagKind, require_rosbags, write_bag
from ebjax.io.write_sequence import write_sequence

TILE_PX = 512
IMAGES = {".jpg", ".jpeg", ".png"}


@dataclasses.dataclass(frozen=True)
class Config(CorridorConfig):
    """Renders a robot's ways there and back through corridors: colour, depth, drifting odometry, truth."""

    out: Path = Path("runs/corridor_world")
    """Folder of the sequence."""
    format: Literal["tum", "bag", "mcap"] = "tum"
    """tum writes a folder in TUM layout; bag adds run.bag (ROS 1) in it, mcap adds run.mcap (ROS 2)."""


def photographs(path: Path) -> Float[np.ndarray, "N n n 3"]:
    """The middle square of an image, or of every image in a folder, as linear reflectance.

    Raises:
      ValueError: no image there, or one that cannot be read; names the file.
    """
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in IMAGES) if path.is_dir() else [path]
    if not files:
        raise ValueError(f"floor.texture is {path}: no JPEG or PNG in that folder")
    squares = []
    for file in files:
        image = read_image(file)
        side = min(image.shape[:2])
        y, x = (image.shape[0] - side) // 2, (image.shape[1] - side) // 2
        square = cv2.resize(image[y : y + side, x : x + side], (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA)
        squares.append(0.9 * (square.astype(np.float32) / 255) ** GAMMA)
    return np.stack(squares)


def render_sequence(config: CorridorConfig, out: str | Path, bag: BagKind | None = None) -> None:
    """Writes the run that `config` describes in TUM layout, whole or not at all; the same seed gives the same files.

    A folder that holds this very run already is left as it is; a bag that it lacks is added.

    Args:
      config: the world, the robot and its camera.
      out: the folder.
      bag: which ROS bag is to be in it too.

    Raises:
      ValueError: a value that no corridor can have; names the key. A folder that holds another run. No rosbags.
      OSError: the folder cannot be written.
    """
    out = Path(out)
    if bag is not None:
        require_rosbags()
    config = CorridorConfig(**{f.name: getattr(config, f.name) for f in dataclasses.fields(CorridorConfig)})
    if (out / "rgb.txt").exists():
        if not ((out / "world.yaml").is_file() and load_config(out / "world.yaml", CorridorConfig) == config):
            raise ValueError(
                f"{out}: holds another run, or one without its world.yaml; remove it or name another folder"
            )
        if bag is not None and not (out / f"run.{bag}").exists():
            write_bag(out / f"run.{bag}", out, bag)
        return
    texture = None if config.floor.texture is None else photographs(config.floor.texture)
    calibration = None if config.camera.file is None else read_calibration(config.camera.file)
    for note in () if calibration is None else calibration.notes:
        print(note)
    recording = record(config, texture, calibration)

    def finish(folder: Path) -> None:
        dump_config(config, folder / "world.yaml")
        if bag is not None:
            write_bag(folder / f"run.{bag}", folder, bag)

    write_sequence(
        out,
        recording.timestamps,
        recording.odom_from_base,
        recording.world_from_base,
        camera_file(recording),
        recording.frame,
        threads=min(8, os.cpu_count() or 1),
        progress=lambda frames, total: progress(frames, total, "rendering"),
        finish=finish,
    )


def camera_file(recording: Recording) -> CameraFile:
    """What camera.json says: the camera that rendered, without the digits that float32 adds."""
    camera = recording.camera
    return CameraFile(
        intrinsics=np.asarray(camera.intrinsics, np.float64).round(6),
        base_from_camera=np.asarray(camera.base_from_camera, np.float64).round(7),
        width=camera.width,
        height=camera.height,
        depth_scale=1000.0,
        distortion_model=camera.lens.model,
        distortion=tuple(np.asarray(camera.lens.coefficients, np.float64).round(7).tolist()),
    )


def main(config: Config) -> None:
    """Renders and says what was written."""
    bag: BagKind | None = None if config.format == "tum" else config.format
    render_sequence(config, config.out, bag)
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
    from ebjax.io.atomic import whole_file

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
