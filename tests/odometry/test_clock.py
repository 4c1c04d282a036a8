import numpy as np
import pytest

from ebjax.geometry.planar import wrapped
from ebjax.odometry.clock import TimeOffset, estimate_offset

SECONDS, FRAME_S = 90.0, 0.35
FINE = np.arange(-3.0, SECONDS + 3.0, 0.02)


def headings(straight, seed=0):
    """A heading over time, rad, on `FINE`: turns of a second or two, both ways, between straight pieces."""
    random = np.random.default_rng(seed)
    rate = np.zeros(len(FINE))
    if straight:
        return rate
    for start in np.arange(0.0, SECONDS, 6.0):
        begin, length = start + random.uniform(0, 3), random.uniform(0.8, 2.0)
        inside = np.clip((FINE - begin) / length, 0, 1)
        rate += random.choice([-1, 1]) * random.uniform(0.3, 0.9) * np.sin(np.pi * inside) ** 2
    return np.cumsum(rate) * 0.02


def estimated(late, *, straight=False, gain=1.0, bias=0.0, known=(-3.0, SECONDS + 3.0), seed=0, wrong=0.0):
    """The offset of images whose stamps are late by so much, against wheels with so much gain and bias."""
    random = np.random.default_rng(seed)
    heading = headings(straight, seed)
    moments = np.arange(1.0, SECONDS - 1.0, FRAME_S)
    stamps = moments + late
    seen = np.interp(moments, FINE, heading)
    sigma = np.full(len(moments) - 1, 0.003)
    turned = np.diff(seen) + sigma * random.standard_normal(len(sigma))
    turned[random.random(len(sigma)) < wrong] += 0.3
    counted = (heading - bias * FINE) / gain

    def heading_at(offset):
        at = stamps + offset
        wheels = np.where((at >= known[0]) & (at <= known[1]), wrapped(np.interp(at, FINE, counted)), np.nan)
        return np.stack([wheels[:-1], wheels[1:]], 1)

    return estimate_offset(turned, sigma, heading_at)


@pytest.mark.parametrize("late", [0.5, 0.1, -0.3])
@pytest.mark.parametrize("seed", range(3))
def test_late_images_are_found(late, seed):
    found = estimated(late, seed=seed)
    assert found.offset_s == pytest.approx(-late, abs=0.03)
    assert 0 < found.sigma_s < 0.03
    assert abs(found.offset_s + late) < 4 * found.sigma_s + 0.005
    assert "turning rates" in found.why


@pytest.mark.parametrize("late", [0.5, -0.3])
def test_wheels_that_count_turns_wrong_do_not_shift_the_clock(late):
    found = estimated(late, gain=1.05, bias=0.004)
    assert found.offset_s == pytest.approx(-late, abs=0.03)
    assert found.sigma_s < 0.03


def test_a_few_wrong_steps_do_not_shift_the_clock():
    assert estimated(0.5, wrong=0.05).offset_s == pytest.approx(-0.5, abs=0.03)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("gain,bias", [(1.0, 0.0), (1.05, 0.004)])
def test_clocks_that_agree_stay_as_they_are(gain, bias, seed):
    found = estimated(0.0, gain=gain, bias=bias, seed=seed)
    assert found.offset_s == 0.0
    assert found.sigma_s < 0.03
    assert found.why == "images and odometry agree"


@pytest.mark.parametrize("late", [0.0, 0.5])
def test_a_straight_drive_tells_nothing_and_says_so(late):
    found = estimated(late, straight=True)
    assert found.offset_s == 0.0
    assert "turns too little" in found.why


@pytest.mark.parametrize("late", [0.5, -0.3])
def test_odometry_may_begin_later_and_end_earlier(late):
    found = estimated(late, known=(8.0, SECONDS - 12.0))
    assert found.offset_s == pytest.approx(-late, abs=0.03)
    assert np.isfinite(found.sigma_s)


def test_few_steps_tell_nothing():
    few = estimate_offset(np.zeros(19), np.ones(19), lambda offset: np.zeros((19, 2)))
    assert few == TimeOffset(why="too few steps to tell")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("late,gain", [(1.7, 1.0), (-1.5, 1.0), (0.0, -1.0)])
def test_turns_that_the_wheels_count_at_another_time_or_not_at_all_fit_no_offset(late, gain, seed):
    found = estimated(late, gain=gain, seed=seed)
    assert found.offset_s == 0.0
    assert found.why == "no offset within 1 s fits"
