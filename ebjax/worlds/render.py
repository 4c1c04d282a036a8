"""Renders a world into a folder that `ebjax.slam` reads: a robot's run in TUM layout, with a ROS bag if asked for."""

import dataclasses
import os
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float

from ebjax.command import dump_config, progress
from ebjax.config import load_config
from ebjax.floors.sensor import GAMMA
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.geometry.camera import Camera
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
    resume: bool = False
    """Keep the frames of a rendering that is interrupted, in .NAME.partial beside --out, and go on from them."""


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


def render_sequence(
    config: CorridorConfig, out: str | Path, bag: BagKind | None = None, *, resume: bool = False
) -> None:
    """Writes the run that `config` describes in TUM layout, whole or not at all; the same seed gives the same files.

    A folder that holds this very run already is left as it is; a bag that it lacks is added.

    Args:
      config: the world, the robot and its camera.
      out: the folder.
      bag: which ROS bag is to be in it too.
      resume: keep the frames of a rendering that is interrupted, and go on from them.

    Raises:
      ValueError: a value that no corridor can have; names the key. A folder that holds another run, or frames of one.
        No rosbags.
      OSError: the folder cannot be written.
    """
    out = Path(out)
    if bag is not None:
        require_rosbags()
    config = CorridorConfig(**{f.name: getattr(config, f.name) for f in dataclasses.fields(CorridorConfig)})
    if (out / "rgb.txt").exists():
        if not _describes(out / "world.yaml", config):
            raise ValueError(
                f"{out}: holds another run, or one without its world.yaml; remove it or name another folder"
            )
        if bag is not None and not (out / f"run.{bag}").exists():
            write_bag(out / f"run.{bag}", out, bag)
        return
    partial = out.absolute().parent / f".{out.absolute().name}.partial"
    if resume:
        _check_begun(config, partial)
    texture = None if config.floor.texture is None else photographs(config.floor.texture)
    calibration = None if config.camera.file is None else read_calibration(config.camera.file)
    for note in () if calibration is None else calibration.notes:
        print(note)
    recording = record(config, texture, calibration)
    if resume:
        dump_config(config, partial / "world.yaml")

    def finish(folder: Path) -> None:
        dump_config(config, folder / "world.yaml")
        if bag is not None:
            write_bag(folder / f"run.{bag}", folder, bag)

    write_sequence(
        out,
        recording.timestamps,
        recording.odom_from_base,
        recording.world_from_base,
        camera_file(recording.camera),
        recording.frame,
        threads=min(8, os.cpu_count() or 1),
        resume=resume,
        progress=lambda frames, total: progress(frames, total, "rendering"),
        finish=finish,
    )


def _describes(path: Path, config: CorridorConfig) -> bool:
    return path.is_file() and load_config(path, CorridorConfig) == config


def _check_begun(config: CorridorConfig, partial: Path) -> None:
    frames = len(list(partial.glob("depth/[!.]*")))
    if frames and not _describes(partial / "world.yaml", config):
        raise ValueError(f"{partial}: holds frames of another run; remove it or name another --out")
    if frames:
        print(f"{partial}: goes on after {frames} frames")


def camera_file(camera: Camera) -> CameraFile:
    """What camera.json says: the camera that rendered, without the digits that float32 adds."""
    return CameraFile(
        intrinsics=np.asarray(camera.intrinsics, np.float64).round(6),
        base_from_camera=np.asarray(camera.base_from_camera, np.float64).round(7),
        width=camera.width,
        height=camera.height,
        depth_scale=1000.0,
        distortion_model=camera.lens.model,
        distortion=tuple(np.asarray(camera.lens.coefficients, np.float64).round(7).tolist()),
    )
