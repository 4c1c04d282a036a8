"""A recorded run driven through the engine, its images decoded a few ahead."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from jaxtyping import Float

from ebjax.slam.config import PipelineConfig
from ebjax.slam.engine import Engine
from ebjax.slam.frame import Frame, Update
from ebjax.slam.recording import Load, Recording

Progress = Callable[[Iterable, int, str], Iterator]
PREFETCH, LOOKED_AHEAD = 4, 2
"""Images that are decoded before their turn, and frames that are looked at."""


def in_silence(items: Iterable, total: int, label: str) -> Iterator:
    """Shows no progress."""
    return iter(items)


def drive(
    mapper: Engine,
    recording: Recording,
    progress: Progress = in_silence,
    told: Callable[[Update], None] = lambda update: None,
) -> None:
    """Adds all frames of a recording; those between keyframes are not decoded where odometry says which these are.

    Args:
      mapper: new, or on a store that is gone on with.
      recording: of the run.
      progress: wraps the loop.
      told: is called with every update.
    """
    first = mapper.next_frame
    frames = with_more_expected(frames_of(recording, mapper.config, first), mapper.expect)
    for k, frame in enumerate(progress(frames, len(recording), "driving")):
        if k < first:
            mapper.pass_by(frame)
        else:
            told(mapper.add(frame))


def with_more_expected(frames: Iterable[Frame], expect: Callable[[int, Frame], None]) -> Iterator[Frame]:
    """The frames, each after `expect` was told of the next with images."""
    coming: deque[Frame] = deque()
    images = 0
    for number, frame in enumerate(frames):
        expect(number, frame)
        coming.append(frame)
        images += frame.rgb is not None
        while images > LOOKED_AHEAD:
            images -= coming[0].rgb is not None
            yield coming.popleft()
    yield from coming


def frames_of(recording: Recording, config: PipelineConfig, first: int = 0) -> Iterator[Frame]:
    """The frames of a recording; without images are those between keyframes, where odometry says which these are.

    Args:
      recording: of the run.
      config: says what moved enough is.
      first: frames before it come without images.
    """
    count, odometry = len(recording), recording.odom_from_base
    due = set(range(count))
    if odometry is not None and config.motion != "floor":
        due = set(moved_enough(odometry, config.keyframe_m, config.keyframe_deg))
    due = {k for k in due if k >= first}
    with ThreadPoolExecutor(2) as pool:
        images = decoded_ahead(pool, recording.load, sorted(due))
        for k in range(count):
            rgb, depth_m = (next(images) if k in due else None) or (None, None)
            odom = None if odometry is None else odometry[k]
            name = recording.names[k] if recording.names else str(k)
            yield Frame(float(recording.timestamps[k]), rgb, depth_m, odom, name)


def moved_enough(odom_from_base: Float[np.ndarray, "F 3"], distance_m: float, turn_deg: float) -> list[int]:
    """Frames at which the robot has moved or turned enough since the last one, the first included."""
    chosen = [0]
    for k in range(1, len(odom_from_base)):
        step = odom_from_base[k] - odom_from_base[chosen[-1]]
        turn = abs(np.arctan2(np.sin(step[2]), np.cos(step[2])))
        if np.hypot(step[0], step[1]) >= distance_m or turn >= np.radians(turn_deg):
            chosen.append(k)
    return chosen


def decoded_ahead(pool: ThreadPoolExecutor, load: Load, frames: list[int]) -> Iterator[Any]:
    """The images of frames, in order, a few of them decoded before they are asked for."""
    waiting = [pool.submit(load, frame) for frame in frames[:PREFETCH]]
    for k in range(len(frames)):
        images = waiting.pop(0).result()
        if k + PREFETCH < len(frames):
            waiting.append(pool.submit(load, frames[k + PREFETCH]))
        yield images
