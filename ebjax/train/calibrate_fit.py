"""From coarse to fine: a camera's mount, and its optics if asked, from the floor it sees under way and from odometry.

The floor is looked at through the camera as it is believed to be, and matched between frames some decimetres apart; of
a grid of mounts the one is taken under which most matches coincide; least squares refines it, and the optics with it;
then the floor is looked at anew through the result.
"""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ebjax.geometry.camera import Camera
from ebjax.odometry.wheels import WheelErrors
from ebjax.train.calibrate_camera import MOUNT, numbers_of, with_numbers
from ebjax.train.calibrate_pairs import FloorPairs, Load, choose_pairs, match_pairs
from ebjax.train.calibrate_solve import Solved, count_agreeing, curvature_sigma, residuals, solve
from ebjax.views.run_view import choose_floor, from_camera

WIDTHS = ((10.0, 4.0), (3.0, 2.0), (2.0,))
"""Of the Cauchy kernel in every look, standard deviations of a match; what lies three widths off is no match."""
SEARCH_SIGMAS = 2.0
SEARCH_STEP = (np.radians(1.0), np.radians(1.0), 0.05)
"""Of the grid: pitch, roll, and height as a share of it."""
SEARCH_LIMIT = 12.0
"""Matches this near count at a mount of the grid, standard deviations: about what half a step of it moves them."""
SEARCH_PAIRS = 40
MIN_SHARE = 0.1
"""Of all matches, that must count at the best mount of the grid; floors that repeat leave half of them or more."""
MIN_MATCHES = 12
MIN_PAIRS = 8
FOLDS = 8


def calibrate(
    load: Load,
    odom_from_base: Float[np.ndarray, "F 3"],
    camera: Camera,
    sigma: Float[np.ndarray, " N"],
    odometry: WheelErrors,
    *,
    pairs: int,
    metres_per_px: float,
    progress: Callable = lambda items, total, label: iter(items),
) -> tuple[Solved, FloorPairs]:
    """Finds the numbers of a camera.

    Args:
      load: frame number -> RGB uint8, or None for a frame that cannot be read.
      odom_from_base: x, y (m), heading (rad) of every frame.
      camera: as it is believed to be.
      sigma: standard deviations of its numbers; zero keeps one. Twice that of pitch, roll and height is searched.
      odometry: how it errs.
      pairs: of frames that are looked at, at most.
      metres_per_px: of the floor views, m.
      progress: wraps the long loops.

    Returns:
      The solution, and the matches that it is made of.

    Raises:
      ValueError: the camera sees no floor, there is too little motion, or too few views agree with it.
    """
    start = numbers = numbers_of(camera)
    frames = None
    for look, widths in enumerate(WIDTHS):
        through = with_numbers(camera, numbers)
        floor = choose_floor(through, metres_per_px)
        view = from_camera(through, floor)
        if frames is None:
            frames = choose_pairs(odom_from_base, view.centre_m, float(floor.x_max - floor.x_min), pairs)
            if len(frames[0]) < MIN_PAIRS:
                raise ValueError(
                    f"{len(frames[0])} pairs of frames that overlap with some motion between them; at least "
                    f"{MIN_PAIRS} are needed: record some metres, a frame every quarter of a metre or 15 degrees"
                )
        matches = match_pairs(load, *frames, odom_from_base, camera, through, view, odometry, progress)
        if look == 0:
            numbers = search(matches, start, sigma)
        for width in widths:
            kept = agreeing(matches, numbers, width)
            found = solve(start, sigma, numbers, kept, width)
            numbers = np.asarray(found.numbers)
    return found, kept


def search(
    pairs: FloorPairs, start: Float[np.ndarray, " N"], sigma: Float[np.ndarray, " N"]
) -> Float[np.ndarray, " N"]:
    """The start with the pitch, roll and height of a grid around it under which most matches coincide.

    Raises:
      ValueError: too few do under any.
    """
    axes = [np.array([value]) for value in start[MOUNT]]
    for k, step in zip((0, 1, 3), SEARCH_STEP, strict=True):
        step = step * (start[k] if k == 3 else 1)
        reach = round(SEARCH_SIGMAS * sigma[k] / step)
        axes[k] = start[k] + step * np.arange(-reach, reach + 1)
    grid = np.array(list(itertools.product(*axes)))
    rows = np.unique(np.linspace(0, len(pairs.motion) - 1, SEARCH_PAIRS).round().astype(int))
    some = pairs.some(rows)
    shares = np.asarray(count_agreeing(grid, some, SEARCH_LIMIT)) / max(some.valid.sum(), 1)
    if shares.max() < MIN_SHARE:
        raise ValueError(
            f"{shares.max():.0%} of the matches of floor views agree with odometry, at least {MIN_SHARE:.0%} must: "
            "check the odometry, the camera's fx, fy, lens and mount, or search farther (--pitch-sigma-deg, "
            "--roll-sigma-deg, --height-sigma)"
        )
    return np.concatenate([grid[int(np.argmax(shares))], start[MOUNT.stop :]])


def agreeing(pairs: FloorPairs, numbers: Float[np.ndarray, " N"], width: float) -> FloorPairs:
    """Drops the matches that lie three widths off, and the pairs that few others are left of.

    Raises:
      ValueError: hardly any pair is left.
    """
    valid = np.asarray(pairs.valid) * (np.asarray(residuals(numbers, pairs, width)[2]) < 3 * width)
    enough = valid.sum(1) >= MIN_MATCHES
    if enough.sum() < MIN_PAIRS:
        raise ValueError(
            f"{enough.sum()} of {len(valid)} pairs of floor views have {MIN_MATCHES} matches that agree, at least "
            f"{MIN_PAIRS} must: record more of the floor, in better light"
        )
    return dataclasses.replace(pairs, valid=(valid * enough[:, None]).astype(pairs.pixels.dtype))


def deviations(
    found: Solved, pairs: FloorPairs, start: Float[np.ndarray, " N"], sigma: Float[np.ndarray, " N"]
) -> Float[np.ndarray, " N"]:
    """Standard deviations of the numbers: by a jackknife over stretches of the run or by the curvature, the larger.

    Matches of neighbouring pairs share frames and errors of odometry, which only the jackknife sees; where the run
    tells nothing, only the curvature does. Neither sees an odometry that is wrong all the time, by its scale, say.
    """
    width = WIDTHS[-1][-1]
    without = []
    for stretch in np.array_split(np.flatnonzero(np.asarray(pairs.valid).any(1)), FOLDS):
        valid = np.array(pairs.valid)
        valid[stretch] = 0
        others = dataclasses.replace(pairs, valid=valid)
        without.append(np.asarray(solve(start, sigma, found.numbers, others, width).numbers))
    jackknife = np.sqrt((FOLDS - 1) * np.var(without, axis=0))
    return np.maximum(jackknife, curvature_sigma(sigma, found.numbers, pairs, width))
