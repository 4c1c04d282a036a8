"""RVL, the lossless code of 16-bit depth images (Wilson 2017), as RTAB-Map and ROS's compressed_depth write it.

32-bit little-endian words of 8 nibbles, the first in the highest bits. A number is nibbles of 3 bits, lowest first; bit
3 says that more follow. Row by row: how many zeros, how many nonzeros, then the zigzag difference of each nonzero pixel
to the nonzero pixel before it; again until the image is full.
"""

import numpy as np
from jaxtyping import Int64, UInt16

MOST_PIXELS = 1 << 26
"""A few bytes can stand for any number of missing pixels."""


def _numbers_from_nibbles(payload: bytes) -> Int64[np.ndarray, " N"]:
    whole = len(payload) // 4 * 4
    bytes_in_order = np.frombuffer(payload, np.uint8, whole).reshape(-1, 4)[:, ::-1].reshape(-1)
    nibbles = np.stack([bytes_in_order >> 4, bytes_in_order & 15], axis=1).reshape(-1)
    ends = np.flatnonzero(nibbles < 8)
    starts = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)[: len(ends)]
    lengths = ends - starts + 1
    numbers = (nibbles[starts] & 7).astype(np.int64)
    longer = np.flatnonzero(lengths > 1)
    for place in range(1, min(int(lengths.max(initial=0)), 11)):
        numbers[longer] |= (nibbles[starts[longer] + place] & 7).astype(np.int64) << (3 * place)
        longer = longer[lengths[longer] > place + 1]
    return numbers


def decode(payload: bytes, width: int, height: int) -> UInt16[np.ndarray, "{height} {width}"]:
    """Decodes an RVL stream.

    Args:
      payload: the words, without a header.
      width: px.
      height: px.

    Raises:
      ValueError: the stream ends too early, or holds more pixels than the image; more pixels than a camera has.
    """
    if width * height > MOST_PIXELS:
        raise ValueError(f"damaged RVL depth of {width} x {height} px")
    numbers, pixels = _numbers_from_nibbles(payload), width * height
    view, position, done, runs = numbers.data, 0, 0, []
    while done < pixels:
        if position + 2 > len(numbers):
            raise ValueError(f"truncated RVL depth: {done} of {pixels} pixels")
        zeros, nonzeros = view[position], view[position + 1]
        runs += [zeros, nonzeros]
        done, position = done + zeros + nonzeros, position + 2 + nonzeros
        if zeros + nonzeros == 0:
            raise ValueError(f"damaged RVL depth: an empty run after {done} pixels")
    if done > pixels or position > len(numbers):
        raise ValueError(f"damaged RVL depth: {done} pixels for {width} x {height}, or a truncated stream")
    lengths, is_depth = np.array(runs, np.int64), np.arange(len(runs)) % 2 == 1
    differences = numbers[:position][np.repeat(is_depth, np.where(is_depth, lengths, 2))]
    image = np.zeros(pixels, np.uint16)
    image[np.repeat(is_depth, lengths)] = np.cumsum((differences >> 1) ^ -(differences & 1)).astype(np.uint16)
    return image.reshape(height, width)


def encode(depth: UInt16[np.ndarray, "H W"]) -> bytes:
    """Encodes a depth image as an RVL stream, byte for byte as the C++ encoder does."""
    flat = depth.reshape(-1).astype(np.int64)
    present = flat > 0
    changes = np.flatnonzero(np.diff(present)) + 1
    lengths = np.diff(np.concatenate([[0], changes, [len(flat)]]))
    if present[:1].any():
        lengths = np.concatenate([[0], lengths])
    if len(lengths) % 2:
        lengths = np.concatenate([lengths, [0]])
    zeros, nonzeros = lengths[::2], lengths[1::2]
    if not len(flat):
        return b""
    differences = np.diff(flat[present], prepend=0)
    numbers = np.empty(2 * len(zeros) + len(differences), np.int64)
    heads = 2 * np.arange(len(zeros)) + np.concatenate([[0], np.cumsum(nonzeros)[:-1]])
    is_head = np.zeros(len(numbers), bool)
    is_head[heads] = is_head[heads + 1] = True
    numbers[heads], numbers[heads + 1] = zeros, nonzeros
    numbers[~is_head] = (differences << 1) ^ (differences >> 63)
    count = 1 + sum((numbers >= 8**place).astype(np.int64) for place in range(1, 11))
    starts = np.cumsum(count) - count
    nibbles = np.zeros(-(-int(count.sum()) // 8) * 8, np.uint8)
    rows = np.arange(len(numbers))
    for place in range(int(count.max())):
        more = np.where(count[rows] > place + 1, 8, 0)
        nibbles[starts[rows] + place] = (numbers[rows] >> (3 * place) & 7) | more
        rows = rows[count[rows] > place + 1]
    return np.ascontiguousarray((nibbles[::2] << 4 | nibbles[1::2]).reshape(-1, 4)[:, ::-1]).tobytes()
