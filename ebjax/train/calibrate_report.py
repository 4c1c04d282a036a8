"""What a calibration found, as calibration.json says it and as it is printed."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera
from ebjax.train.calibrate_camera import MOUNT, names, numbers_of, share_shown, with_numbers
from ebjax.train.calibrate_fit import WIDTHS, deviations
from ebjax.train.calibrate_floor import floor_distance_m
from ebjax.train.calibrate_pairs import KEYPOINT_PX, FloorPairs
from ebjax.train.calibrate_solve import Solved, solve

TOLD = 0.5
"""A run tells a number when it makes its standard deviation smaller than this share of what it was beforehand."""
UNITS = {
    **dict.fromkeys(("pitch", "roll", "yaw"), "deg"),
    **dict.fromkeys(("height", "x", "y"), "m"),
    **dict.fromkeys(("fx", "cx", "cy"), "px"),
}
COLUMNS = ("given", "start", "found", "sigma", "sigma_before")
DIGITS = {"deg": 3, "m": 4, "px": 2, "": 5}


@dataclasses.dataclass(frozen=True)
class Tried:
    """A calibration.

    Attributes:
      sequence: the run's path.
      started: where the start comes from, in words.
      given: the camera as it was given; in an experiment, the truth.
      start: where the search began.
      sigma: how well its numbers were known.
      found: the result.
      pairs: the matches behind it.
      metres_per_px: of the floor views.
      experiment: whether `given` is the truth.
    """

    sequence: str
    started: str
    given: Camera
    start: Camera
    sigma: Float[np.ndarray, " N"]
    found: Solved
    pairs: FloorPairs
    metres_per_px: float
    experiment: bool


def report(tried: Tried) -> dict[str, Any]:
    """What calibration.json says."""
    found, pairs, sigma = tried.found, tried.pairs, tried.sigma
    given, start, numbers = numbers_of(tried.given), numbers_of(tried.start), np.asarray(found.numbers)
    valid = np.asarray(pairs.valid) > 0
    errors = np.sqrt(np.mean(np.asarray(found.errors)[valid.any(1)] ** 2, axis=0))
    told: dict[str, Any] = {
        "sequence": tried.sequence,
        "start": tried.started,
        "pairs_used": int(valid.any(1).sum()),
        "pairs_tried": len(valid),
        "matches": int(valid.sum()),
        "residual_median_px": residual_px(found, valid),
        "odometry_error_rms_sigmas": dict(zip(("x", "y", "heading"), errors.round(2).tolist(), strict=True)),
        "mount": {},
    }
    deviation = deviations(found, pairs, start, sigma)
    optics = np.flatnonzero(sigma) >= MOUNT.stop
    if optics.any():
        alone = sigma.copy()
        alone[MOUNT.stop :] = 0
        before = solve(start, alone, np.where(alone > 0, numbers, start), pairs, WIDTHS[-1][-1])
        told["residual_median_px_by_the_mount_alone"] = residual_px(before, valid)
        told["distortion_model"] = tried.given.lens.model
        told["lens"] = {}
        told["image_shown"] = round(share_shown(with_numbers(tried.start, numbers)), 3)
    for k, name in enumerate(names(tried.given)):
        if k >= MOUNT.stop and not optics.any():
            break
        unit = UNITS.get(name, "")
        factor = 180 / np.pi if unit == "deg" else 1.0
        row = (given[k], start[k], numbers[k], deviation[k], sigma[k])
        entry: dict[str, Any] = {key: round(float(v) * factor, 6) + 0.0 for key, v in zip(COLUMNS, row, strict=True)}
        known = "kept" if not sigma[k] else "by the run" if deviation[k] < TOLD * sigma[k] else "not told by this run"
        place = "mount" if k < MOUNT.stop else "lens"
        told[place][f"{name}_{unit}" if unit else name] = entry | {"known": known}
    told["floor_moved_m"] = round(floor_distance_m(start, numbers, tried.start, tried.metres_per_px), 5)
    if tried.experiment:
        told["floor_error_before_m"] = round(floor_distance_m(given, start, tried.given, tried.metres_per_px), 5)
        told["floor_error_m"] = round(floor_distance_m(given, numbers, tried.given, tried.metres_per_px), 5)
    return told


def residual_px(found: Solved, valid: np.ndarray) -> float:
    """How far apart matches are in the median, px of the view: of both keypoints together, hence the root of two."""
    return round(2**0.5 * KEYPOINT_PX * float(np.median(np.asarray(found.distance)[valid])), 3)


def lines(told: dict[str, Any]) -> list[str]:
    """The same for people."""
    wheels = ", ".join(f"{value:.1f} ({name})" for name, value in told["odometry_error_rms_sigmas"].items())
    alone = told.get("residual_median_px_by_the_mount_alone")
    kept = "" if alone is None else f"; {alone:.2f} by the mount alone"
    found = [
        f"{told['matches']} matches in {told['pairs_used']} of {told['pairs_tried']} pairs of views, "
        f"{told['residual_median_px']:.2f} px apart (median{kept}); odometry errs by {wheels} of its sigmas",
        f"start: {told['start']}",
        "".join(f"{head:>10}" for head in ("", "given", "start", "found", "sigma", "before")),
    ]
    for name, entry in (told["mount"] | told.get("lens", {})).items():
        digits = DIGITS[name.rpartition("_")[2] if name.rpartition("_")[0] in UNITS else ""]
        found.append(f"{name:10}" + "".join(f"{entry[key]:>10.{digits}f}" for key in COLUMNS) + f"  {entry['known']}")
    if told.get("image_shown", 1.0) < 1:
        share = f"{1 - told['image_shown']:.0%}"
        found.append(f"note: this lens does not reach {share} of the image; the run tells it only where floor is seen")
    found.append(f"the floor of the view moved by {1e3 * told['floor_moved_m']:.1f} mm on average")
    if "floor_error_m" in told:
        before, after = (1e3 * told[key] for key in ("floor_error_before_m", "floor_error_m"))
        found.append(f"it lies {after:.1f} mm off where the given camera puts it, on average; {before:.1f} mm before")
    return found
