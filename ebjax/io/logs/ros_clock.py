"""Which clock a log goes by: the stamps in the messages' headers, or when they were received; never both."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int64

MOST_ZEROS = 0.1


def _span(times: np.ndarray) -> tuple[int, int]:
    return int(times.min()), int(times.max())


def _overlap(a: np.ndarray, b: np.ndarray) -> bool:
    (a_first, a_last), (b_first, b_last) = _span(a), _span(b)
    return a_first <= b_last and b_first <= a_last


def clock(images: str, times_ns: Mapping[str, Int64[np.ndarray, "N 2"]]) -> tuple[bool, tuple[str, ...]]:
    """Chooses the times of receipt where a topic has no stamps, or where stamps are of different clocks.

    Args:
      images: the images' topic.
      times_ns: topic -> stamp and receipt of each message, of every topic that will be used.

    Returns:
      Whether the times of receipt are to be used, for everything, and why.
    """
    for topic, times in times_ns.items():
        if len(times) and np.mean(times[:, 0] <= 0) > MOST_ZEROS:
            return True, (f"{topic}: its stamps are 0; the times of receipt are used for every topic",)
    stamped = {topic: times[times[:, 0] > 0] for topic, times in times_ns.items()}
    mine = stamped[images]
    for topic, times in stamped.items():
        if topic == images or not len(times) or not len(mine):
            continue
        if not _overlap(mine[:, 0], times[:, 0]) and _overlap(mine[:, 1], times[:, 1]):
            note = f"{topic}: its stamps are of another clock than those of {images}"
            return True, (f"{note}; the times of receipt are used for every topic",)
    return False, ()
