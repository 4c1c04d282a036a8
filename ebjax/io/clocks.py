"""Clocks of two recordings: in which unit their times are written, and their ranges in words.

Times are arrays in increasing order. Logs and trajectories are meant to be in seconds; sensors' drivers write
nanoseconds (EuRoC, ROS), microseconds (PX4, Livox) and milliseconds (phones, JavaScript) as well.
"""

import dataclasses
from datetime import UTC, datetime

import numpy as np
from jaxtyping import Float

from ebjax.io.trajectory import Trajectory

UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
"""How many of each a second has."""
UNIX_S = (1e9, 4e9)
"""Times since 1970 of recordings from 2001 to 2096, s."""
SPACING_S = (1e-5, 1e3)
"""Samples of a moving robot lie no closer and no farther apart, s."""


def _span(times: Float[np.ndarray, " N"]) -> float:
    return float(times[-1] - times[0])


def median_spacing(times: Float[np.ndarray, " N"]) -> float:
    """Median difference of successive times that differ; 0 where there is none."""
    gaps = np.diff(times)
    return float(np.median(gaps[gaps > 0])) if (gaps > 0).any() else 0.0


def overlap(a: Float[np.ndarray, " N"], b: Float[np.ndarray, " M"]) -> float:
    """Share of the shorter of two ranges that lies in the other; a range of no length lies in it or not."""
    common = min(a[-1], b[-1]) - max(a[0], b[0])
    shorter = min(_span(a), _span(b))
    return float(common >= 0) if shorter == 0 else float(max(common, 0.0) / shorter)


def unix_unit(times: Float[np.ndarray, " N"]) -> str | None:
    """Unit of times since 1970 that are not in seconds; None for seconds and for other clocks.

    A clock that counts nanoseconds from the start of a machine may show the number of a Unix time in milliseconds:
    the spacing of the samples tells them apart.
    """
    return next((unit for unit, per_second in UNITS.items() if _dated(times, per_second)), None)


def _dated(times: Float[np.ndarray, " N"], per_second: float) -> bool:
    first, last, spacing = times[0] / per_second, times[-1] / per_second, median_spacing(times) / per_second
    return bool(UNIX_S[0] <= first and last <= UNIX_S[1] and SPACING_S[0] <= spacing <= SPACING_S[1])


def ratio_unit(times: Float[np.ndarray, " N"], others: Float[np.ndarray, " M"]) -> str | None:
    """Unit of times whose length and spacing both say that it is finer than that of others, which are in seconds."""
    spans, spacings = (_span(times), _span(others)), (median_spacing(times), median_spacing(others))
    if min(*spans, *spacings) == 0:
        return None
    span, spacing = spans[0] / spans[1], spacings[0] / spacings[1]
    unit = min(UNITS, key=lambda name: abs(np.log(span / UNITS[name])))
    # Nearer to the unit than to seconds; ten times as long at most, for a part is compared with a whole too.
    half_way = np.sqrt(UNITS[unit])
    return unit if span > half_way and spacing > half_way and span < 10 * UNITS[unit] else None


def finer_unit(times: Float[np.ndarray, " N"], others: Float[np.ndarray, " M"]) -> str | None:
    """Unit of times in which their range is that of others, which are in seconds; None where both are in seconds.

    Ranges far from 0 agree in one unit only. Ranges from 0 on agree in any, so length and spacing must say it too.
    """
    if _dated(times, 1.0):
        return None
    for unit, per_second in UNITS.items():
        converted = times / per_second
        if overlap(converted, others) < 0.5:
            continue
        far = min(abs(converted[0]) - 100 * _span(converted), abs(others[0]) - 100 * _span(others)) > 0
        if far or ratio_unit(times, others) == unit:
            return unit
    return None


def in_seconds(
    times: Float[np.ndarray, " N"], others: Float[np.ndarray, " M"] | None = None
) -> tuple[Float[np.ndarray, " N"], str | None]:
    """Converts times that are recognised as finer than seconds, by themselves or beside others in seconds.

    Returns:
      The times, and the unit they were in; None where nothing was converted.
    """
    unit = unix_unit(times)
    if unit is None and others is not None:
        unit = finer_unit(times, others)
    return (times if unit is None else times / UNITS[unit]), unit


def unit_note(source: str, unit: str) -> str:
    """Says that times were converted."""
    return f"{source}: its times are {unit}, read as seconds"


def trajectory_in_seconds(
    trajectory: Trajectory, others: Float[np.ndarray, " M"] | None = None
) -> tuple[Trajectory, tuple[str, ...]]:
    """As `in_seconds`, of a trajectory with times; returns it and what was done, a line."""
    times, unit = in_seconds(trajectory.timestamps, others)
    if unit is None:
        return trajectory, ()
    return dataclasses.replace(trajectory, timestamps=times), (unit_note(trajectory.path, unit),)


def seconds_text(value: float) -> str:
    """Formats s to a microsecond, without trailing zeros."""
    text = f"{value:.6f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def time_range(times: Float[np.ndarray, " N"]) -> str:
    """From when to when, and how long; times since 1970 with their date."""
    first, last = float(times[0]), float(times[-1])
    date = ""
    if UNIX_S[0] <= first <= UNIX_S[1]:
        date = f"{datetime.fromtimestamp(first, UTC):%Y-%m-%d %H:%M:%S} UTC, "
    return f"{first:.3f} to {last:.3f} s ({date}{_length(last - first)} long)"


def _length(seconds: float) -> str:
    for name, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 3 * size:
            return f"{seconds / size:.3g} {name}"
    return f"{seconds:.3g} s"
