import numpy as np
import pytest

from ebjax.io.grey_levels import DEPTHS, bits_for, eight_bits


@pytest.mark.parametrize(
    "brightest, bits", [(0, 8), (255, 8), (256, 10), (1023, 10), (1024, 12), (4095, 12), (65535, 16)]
)
def test_the_fewest_usual_bits_that_hold_the_brightest(brightest, bits):
    assert bits_for(brightest) == bits


@pytest.mark.parametrize("bits", DEPTHS)
def test_scaling_keeps_the_order_and_never_wraps(bits):
    levels = eight_bits(np.arange(65536, dtype=np.uint16).reshape(256, 256), bits).reshape(-1).astype(int)
    assert (np.diff(levels) >= 0).all() and levels[(1 << bits) - 1] == 255 and levels[0] == 0 and levels[-1] == 255
