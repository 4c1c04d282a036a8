"""The frames of a recording one after another, rendered as they are asked for: none is held."""

import dataclasses
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from ebjax.floors.sequence import Recording


@dataclasses.dataclass(frozen=True)
class Seen:
    """A frame.

    Attributes:
      stamp_s: s.
      name: the stamp, as files are named by it.
      rgb: colour.
      depth_mm: 0 where it is missing.
      odom_from_base: what the wheels counted.
      world_from_base: the truth.
    """

    stamp_s: float
    name: str
    rgb: UInt8[np.ndarray, "H W 3"]
    depth_mm: UInt16[np.ndarray, "H W"]
    odom_from_base: Float[np.ndarray, "4 4"]
    world_from_base: Float[np.ndarray, "4 4"]


def stream(recording: Recording, *, start: int = 0, ahead: int = 2) -> Iterator[Seen]:
    """Yields the frames in order.

    Args:
      recording: the run.
      start: number of the first frame.
      ahead: frames that are rendered, each in a thread, while one is looked at.
    """

    def seen(i: int) -> Seen:
        poses = recording.odom_from_base[i], recording.world_from_base[i]
        stamp_s = float(recording.timestamps[i])
        return Seen(stamp_s, f"{stamp_s:.6f}", *recording.frame(i), *poses)

    with ThreadPoolExecutor(ahead) as pool:
        waiting = deque(pool.submit(seen, i) for i in range(start, min(start + ahead, len(recording))))
        following = start + len(waiting)
        while waiting:
            frame = waiting.popleft().result()
            if following < len(recording):
                waiting.append(pool.submit(seen, following))
                following += 1
            yield frame
