import numpy as np
import pytest

from ebjax.evaluation.time_offset import disagreement, find_offset
from ebjax.io.poses import poses_from
from ebjax.io.trajectory import Trajectory


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("offset", [1403636579.75, -3600.0, 7.5])
def test_part_of_a_drive_is_found_in_the_whole(drive, drifted, seed, offset):
    rng = np.random.default_rng(seed)
    whole = np.arange(0, 120, 0.02)
    part = np.arange(rng.uniform(0, 50), rng.uniform(70, 119), 0.1)
    reference = Trajectory(whole, drive(seed, whole), "whole")
    estimate = Trajectory(part - offset, 0.3 * drifted(drive(seed, part), seed) + 0.7 * np.eye(4)[None], "part")
    estimate.poses[:, :3, :3] = drifted(drive(seed, part), seed)[:, :3, :3]
    found = find_offset(reference, estimate)
    # A fifth of the coarser step.
    assert abs(found.seconds - offset) < 0.02
    assert found.disagreement < 0.05 < disagreement(reference, estimate, offset + 8)


def test_samples_of_one_recording_coincide_exactly(drive, drifted):
    times = 100 + np.arange(0, 120, 0.1)
    reference = Trajectory(times, drive(5, times - 100), "all")
    rows = np.arange(311, 1010)
    estimate = Trajectory(times[rows] - times[311], drifted(reference.poses[rows], 5), "from 0")
    assert find_offset(reference, estimate).seconds == pytest.approx(times[311], abs=1e-9)


@pytest.mark.parametrize("lengths, expected", [((20, 20), 300.0), ((20, 15), None)])
def test_constant_speed_is_only_paired_from_start_to_start(lengths, expected):
    def ride(length, start):
        times = np.arange(0, length, 0.1)
        place = np.stack([times, 0 * times, 0 * times], axis=1)
        return Trajectory(times + start, poses_from(np.tile(np.eye(3), (len(times), 1, 1)), place), "ride")

    found = find_offset(ride(lengths[0], 300.0), ride(lengths[1], 0.0))
    assert found is None if expected is None else found.seconds == pytest.approx(expected)


def test_what_never_moves_has_no_offset(drive):
    times = np.arange(0, 50, 0.1)
    moving = Trajectory(times, drive(0, times), "moving")
    still = Trajectory(times + 5, np.tile(np.eye(4), (len(times), 1, 1)), "still")
    short = Trajectory(times[:3] + 5, moving.poses[:3], "short")
    for other in (still, short):
        assert find_offset(moving, other) is None and find_offset(other, moving) is None
        assert disagreement(moving, other, 0.0) == float("inf")


def test_other_drives_disagree(drive):
    times = np.arange(0, 60, 0.1)
    found = find_offset(Trajectory(times, drive(1, times), "a"), Trajectory(times + 1e6, drive(2, times), "b"))
    assert found is None or found.disagreement > 0.2
