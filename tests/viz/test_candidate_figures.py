import cv2
import numpy as np
import pytest

from ebjax.viz.candidate_figures import floor_views

SIZE = (60, 80)


def view(corner=None):
    """Grey floor, a red patch in a corner."""
    image = np.full((*SIZE, 3), 128, np.uint8)
    if corner is not None:
        image[corner] = (255, 0, 0)
    return image, np.ones(SIZE, bool)


def red(png):
    """Where the red patches are, as shares of the figure's width and height, from left to right."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(int)
    mask = (image[..., 0] > 200) & (image[..., 1] < 60) & (image[..., 2] < 60)
    _, _, _, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return sorted((x / image.shape[1], y / image.shape[0]) for x, y in centres[1:].tolist())


@pytest.mark.parametrize("opposing", [True, False])
def test_the_earlier_view_is_shown_as_it_is_and_turned(opposing):
    png = floor_views(view(), view(np.s_[:15, :20]), (9, 2), opposing=opposing)
    found = red(png)
    assert len(found) == 1 + opposing
    if opposing:
        (x, y), (turned_x, turned_y) = found
        assert 1 / 3 < x < 1 / 2 and turned_x > 5 / 6
        assert y < 0.45 and turned_y > 0.65


def test_what_is_no_floor_is_blank():
    image, floor = view(np.s_[:15, :20])
    floor[:15, :20] = False
    assert red(floor_views(view(), (image, floor), (9, 2), opposing=False)) == []
