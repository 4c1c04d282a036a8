"""Task `calibrate`: how the camera sits on the robot, from the floor and the odometry of a run, without any truth.

Coarse to fine: the floor is looked at through the camera as given and matched between frames some decimetres apart; of
a grid of mounts the one is taken under which most matches coincide; least squares refines it, the floor is looked at
anew through the result, and so on. Everything is relative to odometry: its metre is the metre of the height, its
direction of travel the zero of the yaw.
"""

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ebjax.command import dump_config, progress
from ebjax.evaluation.run import spread_rows
from ebjax.floors.__main__ import render_sequence
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig
from ebjax.geometry.camera import Camera
from ebjax.geometry.homography import apply as apply_homography
from ebjax.geometry.mount import NAMES, base_from_mounted_camera, mount_of
from ebjax.io.atomic import whole_folder
from ebjax.io.camera_file import CameraFile, write_camera
from ebjax.io.sequence import BrokenFrame, Sequence, read_sequence
from ebjax.slam.floor import camera_from_depth
from ebjax.slam.select import Odometry
from ebjax.slam.view import RunView, choose_floor, from_camera
from ebjax.slam.world import planar
from ebjax.train.calibrate_pairs import KEYPOINT_PX, FloorPairs, choose_pairs, match_pairs
from ebjax.train.calibrate_solve import Solved, count_agreeing, curvature_sigma, on_floor, residuals, solve

WIDTHS = ((10.0, 4.0), (3.0, 2.0), (2.0,))
"""Of the Cauchy kernel, standard deviations of a match, in every look at the floor; three widths away is no match."""
SEARCH_LIMIT = 12.0
SEARCH_SIGMAS = 2.0
SEARCH_STEP = (np.radians(1.0), np.radians(1.0), 0.05)
"""Of the grid: pitch, roll, and height as a share of it."""
SEARCH_PAIRS = 40
FOLDS = 8
MIN_MATCHES = 12
MIN_PAIRS = 8
DEPTH_SIGMA = (np.radians(0.2), np.radians(0.2), 0.01)
"""How far a plane fitted to depth images is trusted: pitch, roll, and height as a share of it."""
Mount = Float[np.ndarray, "6"]


@dataclasses.dataclass(frozen=True)
class Config:
    """Finds pitch, roll, height and yaw of the camera, and where it sits if asked; writes a camera.json."""

    sequence: Path | None = None
    """Folder in TUM layout; None: a synthetic corridor without odometry noise is rendered."""
    depth: Literal["sequence", "none"] = "sequence"
    """Start from a plane fitted to the sequence's depth where it has any, or from camera.json."""
    pitch_off_deg: float = 0.0
    """For experiments: added to the pitch that camera.json says, degrees; what it says is then held to be the truth."""
    roll_off_deg: float = 0.0
    """Added to its roll, degrees."""
    height_off_m: float = 0.0
    """Added to its height, m."""
    pitch_sigma_deg: float = 4.0
    """How far the pitch may be off: twice that is searched, degrees."""
    roll_sigma_deg: float = 2.0
    """Likewise the roll, degrees."""
    height_sigma: float = 0.1
    """Likewise the height, as a share of it."""
    yaw_sigma_deg: float = 2.0
    """Likewise the turn to the left, not searched but found by least squares; 0 keeps it."""
    place_sigma_m: float = 0.0
    """Likewise where on the robot the camera stands, x and y; told by turns only. 0 keeps it."""
    pairs: int = 240
    """Pairs of frames looked at, at most."""
    metres_per_px: float = 0.01
    """Of the floor views, m."""
    odometry: Odometry = dataclasses.field(default_factory=Odometry)


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Calibrates; writes OUT/camera.json, calibration.json and config.yaml, and prints what changed.

    Args:
      config: see there.
      out: the folder.
      resume: nothing is kept on the way: a run takes a minute and starts anew.

    Raises:
      ValueError: a sequence that cannot be read or does not show floor under way; one line.
    """
    del resume
    if config.sequence is None:
        config = dataclasses.replace(config, sequence=out / "sequence")
        render_sequence(CorridorConfig(robot=RobotConfig(drift=0.0)), out / "sequence")
    assert config.sequence is not None
    sequence = read_sequence(config.sequence, depth=config.depth == "sequence")
    given = mount_of(sequence.camera.base_from_camera)
    off = [np.radians(config.pitch_off_deg), np.radians(config.roll_off_deg), 0.0, config.height_off_m, 0.0, 0.0]
    start, sigma = given + np.array(off), beliefs(config, given)
    if sequence.has_depth:
        start, sigma = start_from_depth(sequence, start, sigma)
    try:
        found, pairs = calibrate(config, sequence, start, sigma)
    except ValueError as fault:
        raise ValueError(f"{sequence.path}: {fault}") from None
    mount = np.asarray(found.mount)
    deviation = deviations(found, pairs, start, sigma)
    report = make_report(config, sequence, given, start, sigma, found, pairs, deviation)
    pose = np.asarray(base_from_mounted_camera(jnp.asarray(mount)), np.float64)
    with whole_folder(out) as folder:
        write_camera(folder / "camera.json", dataclasses.replace(sequence.camera, base_from_camera=pose))
        (folder / "calibration.json").write_text(json.dumps(report, indent=1) + "\n")
        dump_config(config, folder / "config.yaml")
    print_table(report)
    print(f"{out}: camera.json, calibration.json; use it: python -m ebjax.slam {sequence.path} --camera {out}/camera.json")


def beliefs(config: Config, given: Mount) -> Mount:
    """Standard deviations of what is believed of the mount beforehand."""
    angles = np.radians([config.pitch_sigma_deg, config.roll_sigma_deg, config.yaw_sigma_deg])
    return np.array([*angles, config.height_sigma * given[3], config.place_sigma_m, config.place_sigma_m])


def start_from_depth(sequence: Sequence, start: Mount, sigma: Mount) -> tuple[Mount, Mount]:
    """Pitch, roll and height of the plane that depth images show, and how far they are trusted."""
    rows = spread_rows(np.arange(len(sequence)), 9).tolist()
    depths = [depth for depth in (readable(sequence.depth, k) for k in rows) if depth is not None]
    try:
        fitted, *_ = camera_from_depth(depths, camera_at(sequence.camera, start))
    except ValueError as fault:
        raise ValueError(f"{sequence.path / 'depth.txt'}: {fault}") from None
    plane = mount_of(np.asarray(fitted.base_from_camera, np.float64))
    told = [0, 1, 3]
    start, sigma = start.copy(), sigma.copy()
    start[told], sigma[told] = plane[told], [*DEPTH_SIGMA[:2], DEPTH_SIGMA[2] * plane[3]]
    return start, sigma


def readable(read: Any, frame: int) -> np.ndarray | None:
    """What `read` makes of a frame, or None for a broken one."""
    try:
        return read(frame)
    except BrokenFrame:
        return None


def camera_at(file: CameraFile, mount: Mount) -> Camera:
    """The camera of a file, mounted like this."""
    pose = base_from_mounted_camera(jnp.asarray(mount))
    return Camera(jnp.asarray(file.intrinsics), pose, file.width, file.height)


def view_of(camera: Camera, metres_per_px: float) -> RunView:
    """The floor that a camera sees well."""
    return from_camera(camera, choose_floor(camera, metres_per_px))


def calibrate(config: Config, sequence: Sequence, start: Mount, sigma: Mount) -> tuple[Solved, FloorPairs]:
    """Looks, searches, solves, looks again.

    Returns:
      The solution, and the matches that it is made of.

    Raises:
      ValueError: too little motion, or too few views that agree with it.
    """
    odometry = planar(sequence.odom_from_base)
    mount, frames = start, None
    for number, widths in enumerate(WIDTHS):
        camera = camera_at(sequence.camera, mount)
        floor = choose_floor(camera, config.metres_per_px)
        view = from_camera(camera, floor)
        if frames is None:
            frames = choose_pairs(odometry, view.centre_m, floor.x_max - floor.x_min, config.pairs)
            if len(frames[0]) < MIN_PAIRS:
                raise ValueError(
                    f"odometry.txt: {len(frames[0])} pairs of frames with motion between them and not too much; "
                    f"at least {MIN_PAIRS} are needed: drive some metres, at no more than half the view a frame"
                )
        matches = match_pairs(
            lambda k: readable(sequence.rgb, k), *frames, odometry, camera, view, config.odometry, progress
        )
        if number == 0:
            mount = search(matches, start, sigma)
        for width in widths:
            kept = agreeing(matches, mount, width)
            found = solve(start, sigma, mount, kept, width)
            mount = np.asarray(found.mount)
    return found, kept


def search(pairs: FloorPairs, start: Mount, sigma: Mount) -> Mount:
    """The mount of a grid around the start under which most matches coincide."""
    axes = [
        value + np.arange(-round(reach / step), round(reach / step) + 1) * step
        for value, reach, step in (
            (start[0], SEARCH_SIGMAS * sigma[0], SEARCH_STEP[0]),
            (start[1], SEARCH_SIGMAS * sigma[1], SEARCH_STEP[1]),
            (start[3], SEARCH_SIGMAS * sigma[3], SEARCH_STEP[2] * start[3]),
        )
    ]
    grid = np.array([[p, r, start[2], h, *start[4:]] for p, r, h in itertools.product(*axes)])
    rows = spread_rows(np.arange(len(pairs.motion)), SEARCH_PAIRS)
    scores = np.asarray(count_agreeing(grid, jax.tree.map(lambda leaf: leaf[rows], pairs), SEARCH_LIMIT))
    return grid[int(np.argmin(scores))]


def agreeing(pairs: FloorPairs, mount: Mount, width: float) -> FloorPairs:
    """Drops the matches that lie three widths off, and pairs with few others.

    Raises:
      ValueError: hardly any pair is left.
    """
    valid = np.asarray(pairs.valid) * (np.asarray(residuals(mount, pairs, width)[2]) < 3 * width)
    enough = valid.sum(1) >= MIN_MATCHES
    if enough.sum() < MIN_PAIRS:
        raise ValueError(
            f"only {enough.sum()} of {len(valid)} pairs of floor views agree with odometry, at least {MIN_PAIRS} must: "
            "check fx, fy and T_base_camera in camera.json, or search farther (pitch_sigma_deg, height_sigma)"
        )
    return dataclasses.replace(pairs, valid=jnp.asarray(valid * enough[:, None], pairs.valid.dtype))


def deviations(found: Solved, pairs: FloorPairs, start: Mount, sigma: Mount) -> Mount:
    """Standard deviations of the mount: those of the curvature, or of a jackknife over stretches of the run if larger.

    Matches of neighbouring pairs share their frames and their odometry's errors, which only the jackknife sees; where
    the run tells nothing, only the curvature knows.
    """
    width = WIDTHS[-1][-1]
    used = np.flatnonzero(np.asarray(pairs.valid).any(1))
    mounts = []
    for fold in np.array_split(used, FOLDS):
        others = dataclasses.replace(pairs, valid=pairs.valid.at[fold].set(0))
        mounts.append(np.asarray(solve(start, sigma, found.mount, others, width).mount))
    spread = np.sqrt((FOLDS - 1) * np.var(mounts, axis=0))
    return np.maximum(spread, np.asarray(curvature_sigma(sigma, found.mount, pairs, width)))


def floor_distance_m(a: Mount, b: Mount, camera: Camera, view: RunView) -> float:
    """Mean distance of the floor points that two mounts give the pixels of a view, m."""
    rows, columns = np.nonzero(np.asarray(view.seen))
    pixels = apply_homography(view.image_from_view, np.stack([columns, rows], 1).astype(np.float64))
    lifted = jnp.concatenate([pixels, jnp.ones_like(pixels[:, :1])], 1)
    rays = lifted @ jnp.linalg.inv(camera.intrinsics).T
    still = jnp.zeros((*rays.shape, 2), rays.dtype)
    first, second = (on_floor(jnp.asarray(mount), rays, still)[0] for mount in (a, b))
    return float(jnp.linalg.norm(first - second, axis=1).mean())


def make_report(
    config: Config,
    sequence: Sequence,
    given: Mount,
    start: Mount,
    sigma: Mount,
    found: Solved,
    pairs: FloorPairs,
    deviation: Mount,
) -> dict[str, Any]:
    """What calibration.json says."""
    mount, valid = np.asarray(found.mount), np.asarray(pairs.valid) > 0
    distance, errors = np.asarray(found.distance)[valid], np.asarray(found.errors)[valid.any(1)]
    report: dict[str, Any] = {
        "sequence": str(sequence.path),
        "start": "plane fitted to depth" if sequence.has_depth else "camera.json",
        "pairs": {"used": int(valid.any(1).sum()), "tried": len(valid)},
        "matches": int(valid.sum()),
        "residual_px": round(float(np.median(distance)) * KEYPOINT_PX * 2**0.5, 3),
        "odometry_error_sigmas": dict(zip(("x", "y", "heading"), rms(errors).round(2).tolist(), strict=True)),
        "mount": {},
    }
    for k, name in enumerate(NAMES):
        unit, factor = ("deg", 180 / np.pi) if k < 3 else ("m", 1.0)
        numbers = {"given": given[k], "start": start[k], "found": mount[k], "sigma": deviation[k]}
        entry: dict[str, Any] = {key: round(float(value) * factor, 5) for key, value in numbers.items()}
        entry["told_by_run"] = bool(deviation[k] < sigma[k] / 2)
        report["mount"][f"{name}_{unit}"] = entry
    camera = camera_at(sequence.camera, mount)
    view = view_of(camera, config.metres_per_px)
    report["floor_moved_m"] = round(floor_distance_m(start, mount, camera, view), 5)
    if config.pitch_off_deg or config.roll_off_deg or config.height_off_m:
        camera = camera_at(sequence.camera, given)
        report["floor_error_m"] = round(floor_distance_m(given, mount, camera, view_of(camera, 0.01)), 5)
    return report


def rms(values: Float[np.ndarray, "N D"]) -> Float[np.ndarray, " D"]:
    """Root mean square of the columns."""
    return np.sqrt(np.mean(values**2, axis=0))


def print_table(report: dict[str, Any]) -> None:
    """The report for people."""
    used, odometry = report["pairs"], report["odometry_error_sigmas"]
    print(
        f"start: {report['start']}; {report['matches']} matches in {used['used']} of {used['tried']} pairs of views, "
        f"{report['residual_px']:.2f} px apart (median); odometry errs by "
        + ", ".join(f"{value:.1f} ({name})" for name, value in odometry.items())
        + " of its standard deviations"
    )
    print(f"{'':12}{'given':>10}{'start':>10}{'found':>10}{'sigma':>10}")
    for name, entry in report["mount"].items():
        digits = 4 if name.endswith("_m") else 3
        numbers = "".join(f"{entry[key]:>10.{digits}f}" for key in ("given", "start", "found", "sigma"))
        print(f"{name:12}{numbers}{'' if entry['told_by_run'] else '  not told by this run'}")
    print(f"the floor of the view moved by {1e3 * report['floor_moved_m']:.1f} mm on average")
    if "floor_error_m" in report:
        print(f"it lies {1e3 * report['floor_error_m']:.1f} mm off where camera.json puts it, on average")
