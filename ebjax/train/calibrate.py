"""Task `calibrate`: how the camera sits on the robot, from the floor and the odometry of a run, without any truth.

Everything is relative to odometry: its metre is the metre of the height, and the direction in which it says the robot
drives is the zero of the yaw. Pitch, roll and the direction of travel show on a straight way; where the camera stands
on the robot (x, y) shows in turns only. The lens shows where the same floor passes through different parts of the
image.
"""

import dataclasses
import json
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from ebjax.command import dump_config, progress
from ebjax.evaluation.run import spread_rows
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.camera import Camera, camera_from
from ebjax.geometry.mount_numbers import NAMES, mount_of
from ebjax.io.atomic import whole_folder
from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.frames import Frames
from ebjax.io.sequence import Sequence, require_odometry
from ebjax.mapping.open_run import camera_source, open_run
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.world import planar
from ebjax.train.calibrate_camera import (
    COEFFICIENTS,
    INTRINSICS,
    MOUNT,
    STRAIGHT,
    coefficient_sigmas,
    names,
    numbers_of,
    with_numbers,
)
from ebjax.train.calibrate_fit import calibrate
from ebjax.train.calibrate_report import Tried, lines, report
from ebjax.train.own_run import OwnRun, log_flags
from ebjax.views.depth_floor import camera_from_depth
from ebjax.views.run_view import choose_floor
from ebjax.worlds.render import render_sequence

DEPTH_IMAGES = 9
DEPTH_SIGMA = (np.radians(0.2), np.radians(0.2), 0.01)
"""How far a plane fitted to depth images is trusted: pitch, roll, and height as a share of it."""


@dataclasses.dataclass(frozen=True)
class Config(OwnRun):
    """Finds pitch, roll, yaw and height of a run's camera; where it stands, and its lens, if asked; writes camera.json.

    Without --sequence a synthetic corridor without odometry noise is rendered.
    """

    depth: Literal["sequence", "none"] = "sequence"
    """Start from a plane fitted to the log's depth where it has any, or from the mount that its camera says."""
    lens: Literal["none", "intrinsics", "distortion", "intrinsics+distortion"] = "none"
    """What of the camera's optics is tuned with its mount: fx (fy keeps its ratio), cx, cy; the coefficients of its
    lens, those of plumb_bob where it has none."""
    pitch_off_deg: float = 0.0
    """For experiments: added to the pitch that the camera's file says, which is then held to be the truth, degrees."""
    roll_off_deg: float = 0.0
    """For experiments: added to its roll, degrees."""
    height_off_m: float = 0.0
    """For experiments: added to its height, m."""
    k1_off: float = 0.0
    """For experiments: added to its k1, as a share of it."""
    pitch_sigma_deg: float = 4.0
    """How well the pitch is known beforehand; twice that is searched, degrees."""
    roll_sigma_deg: float = 2.0
    """Likewise the roll, degrees."""
    height_sigma: float = 0.1
    """Likewise the height, as a share of it."""
    yaw_sigma_deg: float = 2.0
    """How well the turn to the left is known beforehand, degrees; 0 keeps it."""
    place_sigma_m: float = 0.0
    """How well x and y of the camera on the robot are known beforehand, m; 0 keeps them."""
    focal_sigma: float = 0.02
    """With --lens: how well fx is known beforehand, as a share of it; 0 keeps it."""
    centre_sigma: float = 0.01
    """With --lens: how well cx and cy are known beforehand, as a share of the image's width; 0 keeps them."""
    distortion_sigma: float = 0.02
    """With --lens: how well each coefficient is known beforehand: so far it moves the image where it moves it most, as
    a share of its width; 0 keeps them."""
    pairs: int = 240
    """Pairs of frames that are looked at, at most."""
    metres_per_px: float = 0.01
    """Of the floor views, m."""
    odometry: WheelErrors = dataclasses.field(default_factory=WheelErrors)


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Calibrates, writes OUT/camera.json, calibration.json and config.yaml, and prints what changed.

    Args:
      config: see there.
      out: the folder.
      resume: of no use: a calibration takes a minute and starts anew.

    Raises:
      ValueError: a log that cannot be read, or does not tell how its camera is mounted; in one line.
    """
    del resume
    check(config)
    if config.sequence is None:
        config = dataclasses.replace(config, sequence=out / "sequence")
        print(f"no sequence given: rendering a synthetic corridor into {config.sequence}")
        render_sequence(CorridorConfig(robot=RobotConfig(drift=0.0)), out / "sequence")
    sequence = open_run(config)
    source, frames = camera_source(config, sequence), Frames(sequence)
    odometry = planar(require_odometry(sequence, "calibration"))
    given, start, started = starting(config, sequence, source)
    sigma = beliefs(config, given)
    if sequence.has_depth:
        start, sigma, started = *start_from_depth(sequence, frames, start, sigma), "plane fitted to depth"
    for note in sequence.notes:
        print(note)
    try:
        choose_floor(start, config.metres_per_px)
    except ValueError as fault:
        raise ValueError(f"{source}: {fault}") from None
    try:
        found, pairs = calibrate(
            frames.rgb,
            odometry,
            start,
            sigma,
            config.odometry,
            pairs=config.pairs,
            metres_per_px=config.metres_per_px,
            progress=progress,
        )
    except ValueError as fault:
        if frames.faults:
            raise ValueError(f"{sequence.log.colour.source}: {fault}; {frames.told()}") from None
        raise ValueError(f"{sequence.path}: {fault}") from None
    experiment = bool(config.pitch_off_deg or config.roll_off_deg or config.height_off_m or config.k1_off)
    tried = Tried(str(sequence.path), started, given, start, sigma, found, pairs, config.metres_per_px, experiment)
    told, camera = report(tried), with_numbers(start, found.numbers)
    with whole_folder(out) as folder:
        write_camera(folder / "camera.json", camera_file(sequence.camera, camera))
        (folder / "calibration.json").write_text(json.dumps(told, indent=1) + "\n")
        dump_config(config, folder / "config.yaml")
    if frames.faults:
        print(frames.told())
    print("\n".join(lines(told)))
    print(f"{out}: camera.json, calibration.json")
    print(f"use it: python -m ebjax.slam {sequence.path} --camera {out / 'camera.json'}{log_flags(config)}")


def check(config: Config) -> None:
    """Raises ValueError that names a key which says nothing here, or cannot be."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if "_sigma" in field.name and not value >= 0:
            raise ValueError(f"{field.name} is {value}: needs a number from 0; 0 keeps what it is about")
    parts = {"focal_sigma": "intrinsics", "centre_sigma": "intrinsics", "distortion_sigma": "distortion"}
    for name, part in parts.items():
        if getattr(config, name) != getattr(Config, name) and part not in config.lens:
            raise ValueError(f"{name} is {getattr(config, name)}, but lens is {config.lens}: set --lens {part}")


def starting(config: Config, sequence: Sequence, source: str) -> tuple[Camera, Camera, str]:
    """The camera that is given, the one that calibration starts from, and where that comes from.

    Raises:
      ValueError: `k1_off` of a lens that has no k1.
    """
    given, words = camera_from(sequence.camera), source
    if "distortion" in config.lens and given.lens.model == "pinhole":
        given, words = dataclasses.replace(given, lens=STRAIGHT), f"{source}, a plumb_bob lens that bends nothing"
    off = np.zeros(len(numbers_of(given)))
    off[MOUNT] = [*np.radians([config.pitch_off_deg, config.roll_off_deg, 0.0]), config.height_off_m, 0.0, 0.0]
    if config.k1_off:
        if "k1" not in names(given) or sequence.camera.distortion_model == "pinhole":
            raise ValueError(f"k1_off is {config.k1_off}, but {source} says no lens with a k1; leave it out")
        k1 = names(given).index("k1")
        off[k1] = config.k1_off * numbers_of(given)[k1]
    return given, with_numbers(given, numbers_of(given) + off), words


def beliefs(config: Config, given: Camera) -> Float[np.ndarray, " N"]:
    """Standard deviations of what is believed of the camera beforehand; zero keeps a number."""
    numbers, sigma = numbers_of(given), np.zeros(len(numbers_of(given)))
    angles = np.radians([config.pitch_sigma_deg, config.roll_sigma_deg, config.yaw_sigma_deg])
    sigma[MOUNT] = [*angles, config.height_sigma * numbers[3], config.place_sigma_m, config.place_sigma_m]
    if "intrinsics" in config.lens:
        centre_px = config.centre_sigma * given.width
        sigma[INTRINSICS] = [config.focal_sigma * numbers[INTRINSICS.start], centre_px, centre_px]
    if "distortion" in config.lens:
        sigma[COEFFICIENTS] = coefficient_sigmas(given, config.distortion_sigma * given.width)
    return sigma


def start_from_depth(
    sequence: Sequence, frames: Frames, start: Camera, sigma: Float[np.ndarray, " N"]
) -> tuple[Camera, Float[np.ndarray, " N"]]:
    """The camera over the floor that depth images show, and how far its pitch, roll and height are trusted.

    Raises:
      ValueError: they show none.
    """
    rows = spread_rows(np.arange(len(sequence)), DEPTH_IMAGES).tolist()
    depths = [depth for depth in map(frames.depth, rows) if depth is not None]
    try:
        fitted, *_ = camera_from_depth(depths, start)
    except ValueError as fault:
        raise ValueError(f"{sequence.log.depth_source}: {fault}; or start without, --depth none") from None
    plane = mount_of(np.asarray(fitted.base_from_camera, np.float64))
    shown = [NAMES.index(name) for name in ("pitch", "roll", "height")]
    numbers, sigma = numbers_of(start), sigma.copy()
    numbers[shown], sigma[shown] = plane[shown], np.array(DEPTH_SIGMA) * [1, 1, plane[3]]
    return with_numbers(start, numbers), sigma


def camera_file(given: CameraFile, found: Camera) -> CameraFile:
    """The file of a camera that was found, its lens named only where it bends."""
    bent = given.distortion_model != "pinhole" or np.asarray(found.lens.coefficients).any()
    return dataclasses.replace(
        given,
        intrinsics=np.asarray(found.intrinsics, np.float64),
        base_from_camera=np.asarray(found.base_from_camera, np.float64),
        distortion_model=found.lens.model if bent else "pinhole",
        distortion=tuple(np.asarray(found.lens.coefficients, np.float64).tolist()) if bent else (),
    )
