"""Images of more than 8 bits as 8 bits, scaled by the bits that are used.

Cameras of 10, 12 or 14 bits leave either the lower or the upper bits of 16 empty.
"""

import numpy as np
from jaxtyping import UInt8

DEPTHS = (8, 10, 12, 14, 16)


def bits_for(brightest: int) -> int:
    """How many of 16 bits are used where no value is brighter: 8, 10, 12, 14 or 16."""
    return next(bits for bits in DEPTHS if brightest.bit_length() <= bits)


def eight_bits(image: np.ndarray, bits: int) -> UInt8[np.ndarray, "..."]:
    """Scales 16 bits of which `bits` are used; what is brighter than they can tell becomes white."""
    return np.minimum(image >> (bits - 8), 255).astype(np.uint8)
