import itertools
import threading
from dataclasses import replace

import numpy as np
import pytest

from ebjax.floors.cameras import CameraConfig
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.floors.stream import stream
from ebjax.floors.surface import FloorConfig

LAPS = CorridorConfig(
    floor=FloorConfig(texel_m=0.02, ageing_per_m2=0.5),
    robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0, passes=4, lateral_spread_m=0.1),
    camera=CameraConfig(width=80),
)


@pytest.fixture(scope="module")
def recording():
    return record(LAPS)


@pytest.mark.parametrize(("start", "ahead"), [(0, 1), (0, 3), (5, 2), (99, 2)])
def test_frames_come_in_order_and_are_those_of_the_recording(recording, start, ahead):
    numbers = range(len(recording))[start:]
    seen = list(stream(recording, start=start, ahead=ahead))
    assert [frame.stamp_s for frame in seen] == recording.timestamps[start:].tolist()
    for i, frame in zip(numbers, seen, strict=True):
        rgb, depth = recording.frame(i)
        assert np.all(frame.rgb == rgb) and np.all(frame.depth_mm == depth)
        assert frame.name == f"{recording.timestamps[i]:.6f}"
        assert np.all(frame.odom_from_base == recording.odom_from_base[i])
        assert np.all(frame.world_from_base == recording.world_from_base[i])


def test_no_more_is_rendered_than_is_asked_for(recording):
    made, lock = [], threading.Lock()

    def frame(i):
        with lock:
            made.append(i)
        return recording.frame(i)

    taken = list(itertools.islice(stream(replace(recording, frame=frame), ahead=2), 3))
    assert len(taken) == 3 and max(made) <= 3 + 2


def test_a_later_pass_sees_a_worn_floor(recording):
    bare = record(replace(LAPS, floor=replace(LAPS.floor, ageing_per_m2=0.0)))
    differs = [np.any(recording.frame(i)[0] != bare.frame(i)[0]) for i in range(len(bare))]
    assert not any(differs[:3]) and any(differs[-8:])
