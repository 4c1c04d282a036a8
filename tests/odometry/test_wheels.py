import numpy as np
import pytest

from ebjax.geometry.planar import chained
from ebjax.odometry.wheels import Systematic, WheelErrors, corrected, systematic

ERRORS = WheelErrors()
FAULTS = {
    "exact": (1.0, 1.0, 0.0, 0.0),
    "all at once": (1.03, 0.94, -0.8, 0.05),
    "the other way": (0.98, 1.08, 1.2, -0.08),
}


def arcs(metres, radians):
    """Steps of constant curvature."""
    half = radians / 2
    chord = metres * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half), radians], 1)


def drive(fault, seed=0, count=240):
    """True steps, counted ones and seconds: in curves, every eighth step on the spot, and every eighth at rest."""
    scale, gain, bend, drift = fault
    random = np.random.default_rng(seed)
    metres, turned = random.uniform(0.1, 0.25, count), random.uniform(-0.15, 0.15, count)
    spot, rest = (np.arange(count) % 8 == k for k in (3, 7))
    metres[spot | rest], turned[rest] = 0.0, 0.0
    turned[spot] = random.uniform(0.1, 0.3, spot.sum())
    seconds = np.where(rest, 5.0, 0.5)
    counted = metres / scale
    # What is turned is the gain times what is counted, and the bend or the drift at rest.
    beside = np.where(rest, np.radians(drift) * seconds, np.radians(bend) * counted)
    return arcs(metres, turned), arcs(counted, (turned - beside) / gain), seconds


def told(fault, seed, declared, outliers=0.0, jump=False):
    """What noisy steps tell of a drive; the wheels' noise is so much of what is declared."""
    true, counted, seconds = drive(fault, seed)
    random = np.random.default_rng(seed + 1000)
    sigma = np.array([0.002, 0.002, 0.001])
    measured = true + sigma * random.standard_normal(true.shape)
    wrong = random.random(len(true)) < outliers
    measured[wrong] += random.uniform(-1, 1, (wrong.sum(), 3)) * [0.3, 0.3, 0.2]
    sigmas = ERRORS.step_sigmas(chained(counted))
    counted = counted + declared * sigmas * random.standard_normal(true.shape)
    if jump:
        counted[50] += [3.0, -1.0, 0.4]
    return systematic(counted, measured, np.tile(np.diag(sigma**2), (len(true), 1, 1)), sigmas, seconds, ERRORS)


@pytest.mark.parametrize("declared", [0.05, 0.3])
@pytest.mark.parametrize("outliers,jump", [(0.0, False), (0.1, True)])
@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_faults_are_told_within_their_sigmas(fault, outliers, jump, declared):
    off = []
    for seed in range(8):
        found = told(fault, seed, declared, outliers, jump)
        values = np.array([found.scale, found.gain, found.bend_deg_per_m, found.rest_deg_per_s])
        off.append((values - fault) / np.array(found.sigma))
        assert found.steps == 240
        assert (np.array(found.sigma) < [0.003, 0.005, 0.2, 0.005]).all()
    assert (np.abs(off) < 3).all()
    rms = np.sqrt(np.mean(np.square(off), 0))
    assert (rms > 0.3).all() and (rms < 1.6).all()


def test_noise_as_declared_bends_the_estimate_little():
    off = [np.array(found.scale) - 1.03 for found in (told(FAULTS["all at once"], seed, 1.0) for seed in range(8))]
    assert np.abs(off).max() < 0.01


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_corrected_counts_are_the_true_steps(fault):
    true, counted, seconds = drive(fault)
    off = np.abs(corrected(chained(counted), seconds, Systematic(*fault)) - true)
    # Counts of an arc are chords, which are shorter than their arc to second order.
    assert (off < [2e-4, 2e-4, 2e-5]).all()


def test_corrected_by_what_was_told_follows_the_true_path():
    fault = FAULTS["all at once"]
    true, counted, seconds = drive(fault, 3)
    found = told(fault, 3, 0.05)
    plain, better = chained(counted), chained(corrected(chained(counted), seconds, found))
    truth = chained(true)
    apart = [np.linalg.norm(path[:, :2] - truth[:, :2], axis=1).max() for path in (plain, better)]
    assert apart[1] < 0.1 * apart[0] < 1.0


def test_few_steps_tell_nothing():
    true, counted, seconds = drive(FAULTS["all at once"], count=7)
    sigmas = ERRORS.step_sigmas(chained(counted))
    assert systematic(counted, true, np.tile(1e-6 * np.eye(3), (7, 1, 1)), sigmas, seconds, ERRORS) == Systematic()


def test_a_robot_that_stands_still_tells_its_drift_only():
    true, seconds = np.zeros((30, 3)), np.full(30, 2.0)
    counted = true - [0, 0, np.radians(0.05) * 2.0]
    sigmas = ERRORS.step_sigmas(chained(counted))
    found = systematic(counted, true, np.tile(1e-6 * np.eye(3), (30, 1, 1)), sigmas, seconds, ERRORS)
    assert found.scale == 1.0 and found.sigma[0] == pytest.approx(ERRORS.scale_sigma)
    assert found.rest_deg_per_s == pytest.approx(0.05, abs=3 * found.sigma[3])
    assert found.bend_deg_per_m == 0


def test_covariance_of_a_step_is_its_sigmas_squared():
    _, counted, _ = drive(FAULTS["exact"])
    path = chained(counted)
    sigmas, covariance = ERRORS.step_sigmas(path), ERRORS.step_covariance(path)
    np.testing.assert_allclose(covariance, [np.diag(s**2) for s in sigmas], rtol=1e-14)
    assert (sigmas > 0).all()
    # Turning counts round the circle, and a longer step errs more.
    turned = path + [0, 0, 2 * np.pi] * (np.arange(len(path)) % 2)[:, None]
    np.testing.assert_allclose(ERRORS.step_sigmas(turned), sigmas, rtol=1e-12)
    far = ERRORS.step_sigmas(np.array([[0, 0, 0], [0.1, 0, 0], [0.5, 0, 0]], float))
    assert (far[1] > far[0]).all()
