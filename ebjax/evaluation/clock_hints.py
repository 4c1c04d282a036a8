"""What to do about two files whose times do not pair: flags that pair them, tried before they are named.

Units are converted and said. An offset is never applied unasked.
"""

import dataclasses

import numpy as np

from ebjax.evaluation.association import Pairing, pair
from ebjax.evaluation.time_offset import disagreement, find_offset
from ebjax.io.clocks import (
    UNITS,
    median_spacing,
    overlap,
    ratio_unit,
    seconds_text,
    time_range,
    trajectory_in_seconds,
)
from ebjax.io.trajectory import Trajectory

ALIKE = 0.25
"""Paths that disagree more (`Offset.disagreement`) are not taken for the same motion."""


def in_one_unit(
    reference: Trajectory, estimate: Trajectory, time_offset_s: float
) -> tuple[Trajectory, Trajectory, list[str]]:
    """Converts times that are recognised as milliseconds, microseconds or nanoseconds to seconds.

    Returns:
      Reference and estimate, and a line for each conversion.
    """
    estimate, notes = trajectory_in_seconds(estimate)
    reference, more = trajectory_in_seconds(reference)
    estimate, beside = trajectory_in_seconds(estimate, reference.timestamps - time_offset_s)
    reference, other = trajectory_in_seconds(reference, estimate.timestamps + time_offset_s)
    return reference, estimate, [*notes, *more, *beside, *other]


def ranges(pairing: Pairing) -> str:
    """Says when both recordings were made by their own clocks, and how far apart the nearest times are."""
    text = (
        f"the trajectory's times are {time_range(pairing.estimate_times)}, "
        f"the reference's {time_range(pairing.reference_times)}"
    )
    if overlap(pairing.reference_times, pairing.estimate_times) > 0:
        nearest = pair(pairing.reference_times, pairing.estimate_times, np.inf).differences
        text += f", the nearest times {np.median(nearest):.2g} s apart (median)"
    return text


def remedy(reference: Trajectory, estimate: Trajectory, pairing: Pairing) -> str:
    """Names the flags that pair at least half of the poses of the file that has fewer, or says that none were found."""
    return (
        _wider(pairing)
        or _offset(reference, estimate, pairing.max_difference_s)
        or (
            "no offset is found at which both move alike: give the clocks' difference as --time-offset-s, if it is "
            "known, or compare the paths with --match arc"
        )
    )


def _wider(pairing: Pairing) -> str:
    if (wide := _with_difference(pairing)) is None:
        return ""
    return f"{_difference_flag(wide)} pairs {len(wide)} of {wide.possible} poses"


def _difference_flag(pairing: Pairing) -> str:
    return f"--max-time-difference-s {pairing.max_difference_s:g}"


def _with_difference(pairing: Pairing) -> Pairing | None:
    """Pairs by the least difference, up to half a step of the denser file, that pairs nine in ten of what can be."""
    reference_times, estimate_times = pairing.reference_times, pairing.estimate_times
    half_step = min(map(median_spacing, (reference_times, estimate_times))) / 2
    if overlap(reference_times, estimate_times) < 0.5:
        return None
    apart = np.sort(pair(reference_times, estimate_times, 1.05 * half_step).differences)
    if not len(apart):
        return None
    needed = float(apart[int(np.ceil(0.9 * len(apart))) - 1])
    # Rounded up to two digits, so that what is printed pairs what is said.
    unit = 10.0 ** (np.floor(np.log10(max(needed, 1e-6))) - 1)
    wide = pair(reference_times, estimate_times, float(f"{np.ceil(1.001 * needed / unit) * unit:.6g}"))
    return None if wide.few or len(wide) < 2 else wide


def _offset(reference: Trajectory, estimate: Trajectory, max_difference_s: float) -> str:
    said = ""
    for own, other in ((estimate, reference), (reference, estimate)):
        if unit := ratio_unit(own.timestamps, other.timestamps):
            converted = dataclasses.replace(own, timestamps=own.timestamps / UNITS[unit])
            estimate, reference = (converted, reference) if own is estimate else (estimate, converted)
            said = f" (times of {own.path} read as {unit})"
            break
    found = find_offset(reference, estimate)
    if found is None or found.disagreement > ALIKE:
        return ""
    flag = f"--time-offset-s {seconds_text(found.seconds)}"
    shifted = pair(reference.timestamps, estimate.timestamps + float(seconds_text(found.seconds)), max_difference_s)
    if shifted.few or len(shifted) < 2:
        if (wide := _with_difference(shifted)) is None:
            return ""
        shifted, flag = wide, f"{flag} {_difference_flag(wide)}"
    return f"both move alike with {flag}, which pairs {len(shifted)} of {shifted.possible} poses{said}"


def better_offset(reference: Trajectory, estimate: Trajectory, pairing: Pairing, time_offset_s: float) -> str:
    """Says that both move alike at another offset, where they pair but clearly do not now; else nothing.

    Clearly: the paths disagree half as much there, and most pairs are kept.
    """
    now = disagreement(reference, estimate, time_offset_s)
    found = find_offset(reference, estimate)
    if found is None or found.disagreement > min(ALIKE, now) / 2:
        return ""
    times = reference.timestamps, estimate.timestamps + found.seconds
    step = max(pairing.max_difference_s, *map(median_spacing, times))
    if abs(found.seconds - time_offset_s) <= step or len(pair(*times, step)) < 0.8 * len(pairing):
        return ""
    return (
        f"the clocks may differ: both move far more alike with --time-offset-s {seconds_text(found.seconds)} "
        f"(they disagree by {found.disagreement:.1%} of the reference's extent after Sim(3), now by {now:.1%})"
    )
