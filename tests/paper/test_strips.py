import numpy as np
import pytest

from ebjax.floors.surface import FloorConfig
from ebjax.paper.strips import SIZE_PX, strip


@pytest.mark.slow
def test_a_carpet_from_above_is_a_photograph():
    image = strip(FloorConfig(family="carpet"), 3)
    assert image.shape == (*SIZE_PX, 3) and image.dtype == np.uint8 and image.std() > 1
