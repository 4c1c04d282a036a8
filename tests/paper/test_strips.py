import numpy as np

from ebjax.floors.surface import FloorConfig
from ebjax.paper.strips import SIZE_PX, strip


def test_a_carpet_from_above_is_a_photograph():
    image = strip(FloorConfig(family="carpet"), 3)
    assert image.shape == (*SIZE_PX, 3) and image.dtype == np.uint8 and image.std() > 1
