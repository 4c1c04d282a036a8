import numpy as np
import pytest

from ebjax.geometry.camera import FloorView
from ebjax.slam import map as floor_map
from ebjax.slam.map import closeness, mosaic

VIEW = FloorView(0.5, 1.5, -0.6, 0.6, 0.02)
MASK = np.ones(VIEW.size, bool)
MASK[-20:, :8] = MASK[-20:, -8:] = False


def world_colour(x, y):
    """A smooth floor: every colour names a place."""
    return np.stack([128 + 100 * np.sin(x), 128 + 100 * np.cos(1.3 * y), 128 + 100 * np.sin(x + 2 * y)], axis=-1)


def view_from(pose):
    v, u = np.mgrid[: VIEW.height, : VIEW.width]
    base = np.stack([u, v, np.ones_like(u)], axis=-1) @ VIEW.floor_from_view.T
    c, s = np.cos(pose[2]), np.sin(pose[2])
    x, y = c * base[..., 0] - s * base[..., 1] + pose[0], s * base[..., 0] + c * base[..., 1] + pose[1]
    return np.rint(world_colour(x, y)).astype(np.uint8)


POSES = np.array([[0.0, 0.0, 0.0], [0.7, 0.1, 0.2], [2.2, 0.3, np.pi], [1.0, -0.4, -1.2]])


@pytest.mark.parametrize("metres_per_px", [0.02, 0.05])
def test_every_map_pixel_shows_its_place(metres_per_px):
    found = mosaic(map(view_from, POSES), MASK, VIEW.floor_from_view, POSES, metres_per_px=metres_per_px)
    height, width = found.image.shape[:2]
    x_min, x_max, y_min, y_max = found.extent
    assert x_max - x_min == pytest.approx(width * metres_per_px) and y_max - y_min == pytest.approx(
        height * metres_per_px
    )
    row, column = np.mgrid[:height, :width]
    expected = world_colour(x_min + (column + 0.5) * metres_per_px, y_max - (row + 0.5) * metres_per_px)
    seen = found.image[..., 3] > 0
    assert 0.3 < seen.mean() < 1
    # The border of a view is held for half a map pixel; the colours change by up to 200 a metre.
    assert np.abs(found.image[..., :3][seen] - expected[seen]).max() < 200 * metres_per_px


def test_the_view_whose_centre_is_near_wins():
    pose = np.zeros((2, 3))
    pose[1, 0] = 0.4
    dark, light = np.zeros((*VIEW.size, 3), np.uint8), np.full((*VIEW.size, 3), 200, np.uint8)
    found = mosaic([dark, light], MASK, VIEW.floor_from_view, pose)
    middle = found.image[found.image.shape[0] // 2, :, 0]
    centres = [int((x - found.extent[0]) / 0.02) for x in (1.0, 1.4)]
    assert middle[centres[0]] < 40 and middle[centres[1]] > 160


def test_masked_pixels_leave_no_trace():
    wall = np.zeros(VIEW.size, bool)
    wall[:10] = True
    found = mosaic([view_from(POSES[0])], MASK, VIEW.floor_from_view, POSES[:1], masks=[~wall])
    assert not found.image[:, -9:, 3].any() and found.image[:, -12, 3].any()
    weight = closeness(MASK)
    assert weight.max() > 0.9 and np.all(weight[~MASK] == 0) and weight.dtype == np.float32


def test_memory_is_bounded_by_a_coarser_map(monkeypatch):
    monkeypatch.setattr(floor_map, "MAX_PIXELS", 20_000)
    far = POSES + np.array([[0, 0, 0], [0, 0, 0], [50.0, 0, 0], [0, 80.0, 0]])
    found = mosaic(map(view_from, far), MASK, VIEW.floor_from_view, far)
    assert found.metres_per_px > 0.4 and found.image.shape[0] * found.image.shape[1] < 21_000
    assert (found.image[..., 3] > 0).any()


def test_views_must_match_poses():
    with pytest.raises(ValueError, match="longer"):
        mosaic([view_from(POSES[0])], MASK, VIEW.floor_from_view, POSES)
    with pytest.raises(ValueError, match="at least one view"):
        mosaic([], MASK, VIEW.floor_from_view, POSES[:0])
