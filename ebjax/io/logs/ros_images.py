"""The images of a bag's topic: in time order, one a time, each read and decoded when it is asked for."""

from collections.abc import Callable
from functools import partial

import numpy as np

from ebjax.io.grey_levels import bits_for
from ebjax.io.images import BrokenFrame
from ebjax.io.logs.bag import Bag
from ebjax.io.logs.image_survey import spread
from ebjax.io.logs.log import Images
from ebjax.io.logs.ros_collect import Collected
from ebjax.io.logs.ros_image import brightest, compressed_from, raw_from
from ebjax.io.logs.ros_message import COMPRESSED, Image, image_from

SAMPLED = 12


def colour_from(message: Image, kind: str, bits: int | None = None) -> np.ndarray:
    """An Image or CompressedImage as RGB uint8; of `bits` where it has more than 8."""
    return compressed_from(message, bits) if kind == COMPRESSED else raw_from(message, bits)


def bits_in_use(bag: Bag, channel: int) -> int | None:
    """How many bits the grey images of a topic use in common, by a dozen of them; None where they have 8."""
    rows, described = bag.rows(channel), bag.channels[channel]
    found = []
    for row in rows[spread(len(rows), SAMPLED)].tolist():
        try:
            message = image_from(bag.read(row), described.encoding, described.type)
            found.append(brightest(message, described.type == COMPRESSED))
        except ValueError:
            continue
        if found[0] is None:
            return None
    return bits_for(max(value for value in found if value is not None)) if found else None


def _decode(
    bag: Bag, rows: np.ndarray, names: tuple[str, ...], decoder: Callable[[Image, str], np.ndarray], index: int
) -> np.ndarray:
    channel = bag.channels[bag.channel[rows[index]]]
    try:
        return decoder(image_from(bag.read(int(rows[index])), channel.encoding, channel.type), channel.type)
    except ValueError as error:
        raise BrokenFrame(f"{bag.path}: {names[index]}: {error}") from None


def images_of(
    bag: Bag, found: Collected, channel: int, by_receipt: bool, decoder: Callable[[Image, str], np.ndarray]
) -> tuple[Images, tuple[str, ...]]:
    """The images of a topic, named by topic and time, and notes of what was left out.

    Args:
      bag: opened.
      found: what was read of it.
      channel: the images'.
      by_receipt: whether the times are those of receipt.
      decoder: message and its type -> image; a ValueError becomes a BrokenFrame.
    """
    topic, table = bag.channels[channel].topic, found.rows_and_stamps(channel)
    rows, notes = table[:, 0], tuple[str, ...]()
    times = bag.time_ns[rows] if by_receipt else table[:, 1]
    if unstamped := int((times <= 0).sum()):
        notes += (f"{topic}: {unstamped} of {len(times)} images with a stamp of 0 are left out",)
        rows, times = rows[times > 0], times[times > 0]
    if (np.diff(times) < 0).any():
        notes += (f"{topic}: the images are not in the order of their times; they are sorted",)
    unique, first = np.unique(times, return_index=True)
    if len(unique) < len(times):
        notes += (f"{topic}: {len(times) - len(unique)} images at times that occur twice are left out",)
    names = tuple(f"{topic} {time // 10**9}.{time % 10**9 // 1000:06d}" for time in unique.tolist())
    kept = rows[first]
    decode, stored = partial(_decode, bag, kept, names, decoder), partial(_stored, bag, kept)
    packed = bag.channels[channel].type == COMPRESSED
    return Images(f"{topic} of {bag.path}", names, unique * 1e-9, decode, stored=stored if packed else None), notes


def _stored(bag: Bag, rows: np.ndarray, index: int) -> bytes | None:
    channel = bag.channels[bag.channel[rows[index]]]
    try:
        return bytes(image_from(bag.read(int(rows[index])), channel.encoding, channel.type).data)
    except ValueError:
        return None
