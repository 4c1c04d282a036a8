"""What the floor's steps contributed to a run: a table of them, figures for metrics.json, lines for the terminal."""

import csv
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.evaluation.run import reason_counts
from ebjax.io.sequence import Sequence
from ebjax.odometry.motion import Motion
from ebjax.odometry.steps import SCALE_SIGMA, USED

COLUMNS = (
    *("i", "j", "name_i", "name_j", "time_i_s", "time_j_s", "gap", "kind", "inliers", "matches"),
    *("x_m", "y_m", "theta_rad", "cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt", "used", "reason"),
)


def entries(covariance: Float[np.ndarray, "3 3"]) -> list[str]:
    """The upper triangle: xx, xy, xt, yy, yt, tt, in m and rad."""
    return [f"{value:.6e}" for value in covariance[np.triu_indices(3)]]


def write_steps(path: Path, sequence: Sequence, motion: Motion) -> None:
    """Every measured step: between which frames, how, what was measured, and whether and why it counts."""
    steps, frames = motion.steps, motion.frames
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)
        for k in range(len(steps.i)):
            i, j = int(frames[steps.i[k]]), int(frames[steps.j[k]])
            rows.writerow([
                i, j, sequence.names[i], sequence.names[j], f"{sequence.timestamps[i]:.6f}",
                f"{sequence.timestamps[j]:.6f}", steps.i[k] - steps.j[k], steps.kind[k], steps.inliers[k],
                steps.matches[k], *(f"{value:.7f}" for value in steps.i_from_j[k]), *entries(steps.covariance[k]),
                int(steps.reason[k] == USED), steps.reason[k],
            ])  # fmt: skip


def spanned_steps(motion: Motion) -> int:
    """Steps that nothing measured but what spans more than one."""
    steps = motion.steps
    consecutive = steps.used & (steps.i - steps.j == 1)
    return len(motion.frames) - 1 - len(np.unique(steps.i[consecutive])) - motion.carried


def motion_metrics(motion: Motion) -> dict[str, Any]:
    """What metrics.json says of the steps, the wheels, the clock and the mount."""
    steps = motion.steps
    consecutive = steps.used & (steps.i - steps.j == 1)
    seen = consecutive & np.isin(steps.kind, ["floor", "depth"])
    wheels = motion.wheels
    return {
        "steps": len(motion.frames) - 1,
        "measured": len(np.unique(steps.i[seen])),
        "bridged": len(np.unique(steps.i[consecutive & ~seen])),
        "spanned": spanned_steps(motion),
        "carried": motion.carried,
        "pairs_measured": int(steps.used.sum()),
        "pairs_refused": int((~steps.used).sum()),
        "refused": reason_counts([str(reason) for reason in steps.reason[~steps.used]]),
        "jumps": [
            {"frame": j.frame, "metres": j.metres, "degrees": j.degrees, "seconds": j.seconds} for j in motion.jumps
        ],
        "wheels": None
        if wheels is None
        else {
            "scale": wheels.scale,
            "gain": wheels.gain,
            "bend_deg_per_m": wheels.bend_deg_per_m,
            "rest_deg_per_s": wheels.rest_deg_per_s,
            "sigma": list(wheels.sigma),
        },
        "time_offset": {
            "offset_s": motion.offset.offset_s,
            "sigma_s": motion.offset.sigma_s if np.isfinite(motion.offset.sigma_s) else None,
            "why": motion.offset.why,
        },
        "mount": {
            "pitch_deg": motion.tilt.pitch_deg,
            "roll_deg": motion.tilt.roll_deg,
            "pitch_sigma_deg": motion.tilt.pitch_sigma_deg,
            "roll_sigma_deg": motion.tilt.roll_sigma_deg,
            "applied": motion.tilt.applied,
            **({} if motion.reach is None else dataclasses.asdict(motion.reach)),
        },
        "scale_sigma": SCALE_SIGMA,
        "warnings": list(motion.warnings),
    }


def motion_lines(metrics: Mapping[str, Any]) -> list[str]:
    """The same for the terminal, what matters only."""
    found = metrics["motion"]
    if found is None:
        return []
    pairs = found["pairs_measured"] + found["pairs_refused"]
    lines = [
        f"steps: {found['measured']} of {found['steps']} measured on the floor, {found['bridged']} by the whole image, "
        f"{found['spanned']} by frames further apart, {found['carried']} by nothing; {found['pairs_refused']} of "
        f"{pairs} pairs refused"
    ]
    for jump in found["jumps"][:5]:
        lines.append(
            f"odometry jumps at frame {jump['frame']}: {jump['metres']:.2f} m and {jump['degrees']:.1f} degrees in "
            f"{jump['seconds']:.2f} s contradict the floor; that step is taken as unknown"
        )
    if len(found["jumps"]) > 5:
        lines.append(f"... and at {len(found['jumps']) - 5} more frames, see metrics.json")
    if wheels := found["wheels"]:
        scale, gain, bend, _ = wheels["sigma"]
        lines.append(
            f"wheels: {wheels['scale']:.4f} +- {scale:.4f} m a metre counted, {wheels['gain']:.4f} +- {gain:.4f} of "
            f"the turn counted, {wheels['bend_deg_per_m']:.2f} +- {bend:.2f} degrees a metre"
        )
    clock = found["time_offset"]
    if clock["offset_s"]:
        lines.append(
            f"images' clock: {clock['offset_s']:+.3f} +- {clock['sigma_s']:.3f} s added to their stamps, since "
            f"{clock['why']}"
        )
    mount = found["mount"]
    if mount["applied"]:
        lines.append(
            f"camera's mount: pitch {mount['pitch_deg']:+.3f} +- {mount['pitch_sigma_deg']:.3f}, roll "
            f"{mount['roll_deg']:+.3f} +- {mount['roll_sigma_deg']:.3f} degrees off the given one, put right"
        )
    if "height_m" in mount:
        lines.append(
            f"camera's mount: height {mount['height_m']:+.4f} +- {mount['height_sigma_m']:.4f}, x "
            f"{mount['x_m']:+.4f} +- {mount['x_sigma_m']:.4f} m off the given one, put right"
        )
    return lines
