"""Task `calibrate`: how the camera sits on the robot, from the floor and the odometry of a run, without any truth.

Everything is relative to odometry: its metre is the metre of the height, and the direction in which it says the robot
drives is the zero of the yaw. Pitch, roll and the direction of travel show on a straight way; where the camera stands
on the robot (x, y) shows in turns only.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.command import dump_config, progress
from ebjax.evaluation.run import spread_rows
from ebjax.floors.__main__ import render_sequence
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.camera import Camera, camera_from
from ebjax.geometry.mount import base_from_mounted_camera
from ebjax.geometry.mount_numbers import NAMES, mount_of
from ebjax.io.atomic import whole_folder
from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.sequence import BrokenFrame, Sequence, read_sequence, require_odometry
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.world import planar
from ebjax.train.calibrate_mount import calibrate, deviations, floor_distance_m
from ebjax.train.calibrate_pairs import KEYPOINT_PX, FloorPairs
from ebjax.train.calibrate_solve import Solved
from ebjax.views.depth_floor import camera_from_depth

DEPTH_IMAGES = 9
DEPTH_SIGMA = (np.radians(0.2), np.radians(0.2), 0.01)
"""How far a plane fitted to depth images is trusted: pitch, roll, and height as a share of it."""
TOLD = 0.5
"""A run tells a number when it makes its standard deviation smaller than this share of what it was beforehand."""


@dataclasses.dataclass(frozen=True)
class Config:
    """Finds pitch, roll, yaw and height of a run's camera, and where it stands if asked; writes a camera.json."""

    sequence: Path | None = None
    """Folder in TUM layout; None: a synthetic corridor without odometry noise is rendered."""
    depth: Literal["sequence", "none"] = "sequence"
    """Start from a plane fitted to the sequence's depth where it has any, or from camera.json."""
    pitch_off_deg: float = 0.0
    """For experiments: added to the pitch that camera.json says, which is then held to be the truth, degrees."""
    roll_off_deg: float = 0.0
    """For experiments: added to its roll, degrees."""
    height_off_m: float = 0.0
    """For experiments: added to its height, m."""
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
      ValueError: a sequence that cannot be read, or does not tell how its camera is mounted; in one line.
    """
    del resume
    if config.sequence is None:
        config = dataclasses.replace(config, sequence=out / "sequence")
        print(f"no sequence given: rendering a synthetic corridor into {config.sequence}")
        render_sequence(CorridorConfig(robot=RobotConfig(drift=0.0)), out / "sequence")
    assert config.sequence is not None
    sequence = read_sequence(config.sequence, depth=config.depth == "sequence")
    given = mount_of(sequence.camera.base_from_camera)
    off = np.radians([config.pitch_off_deg, config.roll_off_deg, 0.0])
    start, sigma = given + np.array([*off, config.height_off_m, 0.0, 0.0]), beliefs(config, given)
    if sequence.has_depth:
        start, sigma = start_from_depth(sequence, start, sigma)
    try:
        found, pairs = calibrate(
            lambda k: readable(sequence.rgb, k),
            planar(require_odometry(sequence, "calibration")),
            camera_at(sequence.camera, start),
            sigma,
            config.odometry,
            pairs=config.pairs,
            metres_per_px=config.metres_per_px,
            progress=progress,
        )
    except ValueError as fault:
        raise ValueError(f"{sequence.path}: {fault}") from None
    report = make_report(config, sequence, given, start, sigma, found, pairs)
    pose = np.asarray(base_from_mounted_camera(found.mount), np.float64)
    with whole_folder(out) as folder:
        write_camera(folder / "camera.json", dataclasses.replace(sequence.camera, base_from_camera=pose))
        (folder / "calibration.json").write_text(json.dumps(report, indent=1) + "\n")
        dump_config(config, folder / "config.yaml")
    print_report(report)
    print(f"{out}: camera.json, calibration.json")
    print(f"use it: python -m ebjax.slam {sequence.path} --camera {out / 'camera.json'}")


def beliefs(config: Config, given: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6"]:
    """Standard deviations of what is believed of the mount beforehand."""
    angles = np.radians([config.pitch_sigma_deg, config.roll_sigma_deg, config.yaw_sigma_deg])
    return np.array([*angles, config.height_sigma * given[3], config.place_sigma_m, config.place_sigma_m])


def camera_at(file: CameraFile, mount: Float[np.ndarray, "6"]) -> Camera:
    """The camera of a file, mounted like this."""
    return dataclasses.replace(camera_from(file), base_from_camera=base_from_mounted_camera(jnp.asarray(mount)))


def readable(read: Any, frame: int) -> np.ndarray | None:
    """What `read` makes of a frame, or None for a broken one."""
    try:
        return read(frame)
    except BrokenFrame:
        return None


def start_from_depth(
    sequence: Sequence, start: Float[np.ndarray, "6"], sigma: Float[np.ndarray, "6"]
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
    """Pitch, roll and height of the floor that depth images show, and how far they are trusted.

    Raises:
      ValueError: they show none.
    """
    rows = spread_rows(np.arange(len(sequence)), DEPTH_IMAGES).tolist()
    depths = [depth for depth in (readable(sequence.depth, k) for k in rows) if depth is not None]
    try:
        fitted, *_ = camera_from_depth(depths, camera_at(sequence.camera, start))
    except ValueError as fault:
        raise ValueError(f"{sequence.path / 'depth.txt'}: {fault}") from None
    plane = mount_of(np.asarray(fitted.base_from_camera, np.float64))
    shown = [NAMES.index(name) for name in ("pitch", "roll", "height")]
    start, sigma = start.copy(), sigma.copy()
    start[shown], sigma[shown] = plane[shown], np.array(DEPTH_SIGMA) * [1, 1, plane[3]]
    return start, sigma


def make_report(
    config: Config,
    sequence: Sequence,
    given: Float[np.ndarray, "6"],
    start: Float[np.ndarray, "6"],
    sigma: Float[np.ndarray, "6"],
    found: Solved,
    pairs: FloorPairs,
) -> dict[str, Any]:
    """What calibration.json says."""
    mount, valid = np.asarray(found.mount), np.asarray(pairs.valid) > 0
    deviation = deviations(found, pairs, start, sigma)
    errors = np.sqrt(np.mean(np.asarray(found.errors)[valid.any(1)] ** 2, axis=0))
    report: dict[str, Any] = {
        "sequence": str(sequence.path),
        "start": "plane fitted to depth" if sequence.has_depth else "camera.json",
        "pairs_used": int(valid.any(1).sum()),
        "pairs_tried": len(valid),
        "matches": int(valid.sum()),
        # Of both keypoints of a match together, hence the root of two.
        "residual_median_px": round(2**0.5 * KEYPOINT_PX * float(np.median(np.asarray(found.distance)[valid])), 3),
        "odometry_error_rms_sigmas": dict(zip(("x", "y", "heading"), errors.round(2).tolist(), strict=True)),
        "mount": {},
    }
    for k, name in enumerate(NAMES):
        unit, factor = ("deg", 180 / np.pi) if name in ("pitch", "roll", "yaw") else ("m", 1.0)
        numbers = {"given": given[k], "start": start[k], "found": mount[k], "sigma": deviation[k]}
        entry: dict[str, Any] = {key: round(float(value) * factor, 5) for key, value in numbers.items()}
        told = "by the run" if deviation[k] < TOLD * sigma[k] else "not told by this run"
        report["mount"][f"{name}_{unit}"] = entry | {"known": told if sigma[k] > 0 else "kept"}
    view = camera_at(sequence.camera, mount), config.metres_per_px
    report["floor_moved_m"] = round(floor_distance_m(start, mount, *view), 5)
    if config.pitch_off_deg or config.roll_off_deg or config.height_off_m:
        view = camera_at(sequence.camera, given), config.metres_per_px
        report["floor_error_m"] = round(floor_distance_m(given, mount, *view), 5)
    return report


def print_report(report: dict[str, Any]) -> None:
    """The same for people."""
    errors = ", ".join(f"{value:.1f} ({name})" for name, value in report["odometry_error_rms_sigmas"].items())
    print(
        f"{report['matches']} matches in {report['pairs_used']} of {report['pairs_tried']} pairs of views, "
        f"{report['residual_median_px']:.2f} px apart (median); odometry errs by {errors} of its standard deviations"
    )
    print(f"start: {report['start']}")
    print(f"{'':10}{'given':>10}{'start':>10}{'found':>10}{'sigma':>10}")
    for name, entry in report["mount"].items():
        digits = 4 if name.endswith("_m") else 3
        numbers = "".join(f"{entry[key]:>10.{digits}f}" for key in ("given", "start", "found", "sigma"))
        print(f"{name:10}{numbers}  {entry['known']}")
    print(f"the floor of the view moved by {1e3 * report['floor_moved_m']:.1f} mm on average")
    if "floor_error_m" in report:
        print(f"it lies {1e3 * report['floor_error_m']:.1f} mm off where camera.json puts it, on average")
