import dataclasses

import numpy as np
import pytest

from ebjax.features.extractor import extractor
from ebjax.geometry.camera import camera_over_floor
from ebjax.places.descriptor import descriptor
from ebjax.slam.lean import Asked
from ebjax.slam.lens_check import lens_warning
from ebjax.views.run_view import choose_floor, from_camera


@dataclasses.dataclass(frozen=True)
class Counted(Asked):
    """Agrees as often as it is told for each lens."""

    counts: dict[str, int] = dataclasses.field(default_factory=dict)

    def agree(self, pairs, level_from_base=None, camera=None):
        assert all(i > j for i, j in pairs)
        return self.counts[(camera or self.camera).lens.model]


@pytest.mark.parametrize(
    "counts, named",
    [
        ({"pinhole": 1000, "plumb_bob": 1100, "equidistant": 1500}, "equidistant"),
        ({"pinhole": 200, "plumb_bob": 900, "equidistant": 400}, "plumb_bob"),
        ({"pinhole": 1800, "plumb_bob": 1700, "equidistant": 1300}, None),
        ({"pinhole": 10, "plumb_bob": 60, "equidistant": 40}, None),
    ],
)
def test_a_lens_is_named_where_it_explains_clearly_more(counts, named):
    camera = camera_over_floor(300.0, 300.0, 159.5, 119.5, 320, 240, 0.5, 0.5)

    def view_of(camera):
        return from_camera(camera, choose_floor(camera, 0.01))

    def load(frame):
        return None

    asked = Counted(load, camera, view_of, extractor("rootsift"), descriptor("hog"), 0, counts)
    said = lens_warning(asked, [camera], np.arange(3, 90))
    if named is None:
        assert said is None
    else:
        assert f"{counts[named]} matches through {named}" in said and "give it with --camera FILE" in said
