import numpy as np
import pytest

from ebjax.floors.atlas import make_atlas
from ebjax.floors.laying import GUTTER


@pytest.fixture(scope="module")
def any_floor():
    """Noise in place of the floors that runs lay, which takes seconds."""

    def floor_of(plan, config, **rest):
        image = np.random.default_rng(0).uniform(0.2, 0.8, (128, 512, 3)).astype(np.float32)
        return make_atlas(image, [GUTTER], plan, config.texel_m)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ebjax.floors.laying.floor_of", floor_of)
        yield
