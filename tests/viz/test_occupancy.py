import numpy as np
import pytest

from ebjax.geometry.camera import FloorView, camera_over_floor
from ebjax.slam.map import FloorMap
from ebjax.views.floor_view import OBSTACLE_M
from ebjax.viz.occupancy import FREE, OCCUPIED, UNKNOWN, floor_only, occupancy

VIEW = FloorView(0.6, 2.4, -0.9, 0.9, 0.01)
SEEN = np.ones(VIEW.size, bool)
SEEN[-30:, :20] = SEEN[-30:, -20:] = False
WALL_X, POST, RADIUS = 2.0, np.array([1.3, 0.2]), 0.05


def camera_at(height_m, pitch):
    return np.asarray(
        camera_over_floor(600.0, 600.0, 320.0, 240.0, 640, 480, height_m, pitch, 0.0, 0.2).base_from_camera
    )


def floor_seen(pose, base_from_camera, *, wall=True, post=True):
    """View pixels that show floor, by rays that meet a wall and a post; their lowest part counts as floor."""
    v, u = np.mgrid[: VIEW.height, : VIEW.width]
    end = np.stack([u, v, np.ones_like(u)], -1) @ VIEW.floor_from_view.T
    end[..., 2] = 0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    eye = turn @ base_from_camera[:3, 3] + [pose[0], pose[1], 0]
    way = end @ turn.T + [pose[0], pose[1], 0] - eye
    share = np.full(SEEN.shape, 2.0)
    if wall:
        at = (WALL_X - eye[0]) / np.where(np.abs(way[..., 0]) < 1e-9, 1e-9, way[..., 0])
        share = np.where(at > 0, np.minimum(share, at), share)
    if post:
        a, b = (way[..., :2] ** 2).sum(-1), (way[..., :2] * (eye[:2] - POST)).sum(-1)
        inside = b**2 - a * (((eye[:2] - POST) ** 2).sum() - RADIUS**2)
        at = (-b - np.sqrt(np.maximum(inside, 0))) / a
        share = np.where((inside > 0) & (at > 0), np.minimum(share, at), share)
    depth = share * (way @ (turn @ base_from_camera[:3, 2]))
    up = eye[2] * (1 - share)
    return SEEN & ~((share < 1) & (up > OBSTACLE_M[0] + OBSTACLE_M[1] * depth))


def grid(metres_per_px, extent=(-1.0, 4.0, -2.5, 2.5)):
    width, height = (round((high - low) / metres_per_px) for low, high in (extent[:2], extent[2:]))
    return FloorMap(np.zeros((height, width, 4), np.uint8), extent, metres_per_px)


def centres(floor):
    row, column = np.mgrid[: floor.image.shape[0], : floor.image.shape[1]]
    scale = floor.metres_per_px
    return floor.extent[0] + (column + 0.5) * scale, floor.extent[3] - (row + 0.5) * scale


POSES = np.array([[0.0, 0, 0], [0.3, 0.1, 0.1], [0.1, 0.6, -0.3], [0.5, -0.6, 0.4], [0.2, -0.1, 0.0]])


@pytest.mark.parametrize("height_m, pitch, cell", [(0.54, 0.33, 0.02), (0.3, 0.25, 0.02), (1.0, 0.6, 0.05)])
def test_a_wall_stands_where_it_is_and_not_where_depth_first_sees_it(height_m, pitch, cell):
    pose, floor = camera_at(height_m, pitch), grid(cell)
    masks = [floor_seen(p, pose) for p in POSES]
    cells = occupancy(iter(masks), SEEN, VIEW.floor_from_view, pose, POSES, floor)
    x, y = centres(floor)
    beside_post = np.hypot(x - POST[0], y - POST[1]) > 0.3
    assert (cells[x > WALL_X + 1.5 * cell] != FREE).all()
    wall = (cells == OCCUPIED) & beside_post & (x > 1.5)
    assert wall.sum() > 0.5 / cell and np.abs(x[wall] - WALL_X).max() < 2 * cell
    rows = np.flatnonzero((np.abs(y) < 0.4).all(1))
    assert np.mean([(cells[row, np.abs(x[row] - WALL_X) < 2 * cell] == OCCUPIED).any() for row in rows]) > 0.9


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_depth_that_is_missing_on_a_wall_puts_nothing_behind_it(share):
    pose, floor, draw = camera_at(0.54, 0.33), grid(0.02), np.random.default_rng(0)
    masks = [floor_seen(p, pose, post=False) | (SEEN & (draw.random(SEEN.shape) < share)) for p in POSES]
    cells = occupancy(iter(masks), SEEN, VIEW.floor_from_view, pose, POSES, floor)
    x, _ = centres(floor)
    assert (cells[x > WALL_X + 0.04] == UNKNOWN).all()
    assert (cells[np.abs(x - WALL_X) < 0.02] == OCCUPIED).sum() > 50


@pytest.mark.parametrize("cell", [0.02, 0.04])
def test_a_post_stands_and_the_floor_behind_it_is_free_where_another_view_shows_it(cell):
    pose, floor = camera_at(0.54, 0.33), grid(cell)
    masks = [floor_seen(p, pose, wall=False) for p in POSES]
    cells = occupancy(iter(masks), SEEN, VIEW.floor_from_view, pose, POSES, floor)
    x, y = centres(floor)
    away = np.hypot(x - POST[0], y - POST[1])
    assert (cells == OCCUPIED).any() and away[cells == OCCUPIED].max() < RADIUS + 2 * cell
    assert (cells[(x > 1.5) & (x < 1.9) & (np.abs(y - 0.2) < 0.1)] == FREE).all()


def test_who_passes_by_leaves_nothing():
    pose, floor = camera_at(0.54, 0.33), grid(0.02)
    still = np.tile(POSES[:1], (4, 1))
    masks = [floor_seen(still[0], pose, wall=False, post=k == 1) for k in range(4)]
    cells = occupancy(iter(masks), SEEN, VIEW.floor_from_view, pose, still, floor)
    assert not (cells == OCCUPIED).any() and (cells == FREE).any()


@pytest.mark.parametrize("pose", [np.zeros(3), np.array([1.0, -0.5, 2.2])])
def test_without_depth_what_a_view_shows_is_free(pose):
    floor = grid(0.02, (-3.0, 4.0, -3.5, 3.5))
    cells = occupancy(None, SEEN, VIEW.floor_from_view, camera_at(0.54, 0.33), pose[None], floor)
    x, y = centres(floor)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    base_x, base_y = c * (x - pose[0]) + s * (y - pose[1]), c * (y - pose[1]) - s * (x - pose[0])
    within = (base_x > 0.93) & (base_x < 2.37) & (np.abs(base_y) < 0.87)
    outside = (base_x < 0.57) | (base_x > 2.43) | (np.abs(base_y) > 0.93)
    assert set(np.unique(cells)) == {UNKNOWN, FREE}
    assert (cells[within] == FREE).all() and (cells[outside] == UNKNOWN).all()


def test_each_pose_has_a_mask():
    with pytest.raises(ValueError, match="zip"):
        occupancy(iter([SEEN]), SEEN, VIEW.floor_from_view, camera_at(0.54, 0.33), POSES, grid(0.05))


def test_the_picture_of_the_floor_shows_free_cells_only_without_specks():
    floor = grid(0.05)
    floor.image[:] = 200
    cells = np.full(floor.image.shape[:2], UNKNOWN, np.int8)
    cells[20:60, 30:70] = FREE
    cells[40, 50] = OCCUPIED
    cells[5:8, 5:8] = FREE  # 0.02 m^2 behind a wall
    shown = floor_only(floor, cells)
    assert shown.image.shape == (40, 40, 4)
    np.testing.assert_array_equal(shown.image[..., 3] > 0, cells[20:60, 30:70] == FREE)
    np.testing.assert_allclose(shown.extent, (-1 + 30 * 0.05, -1 + 70 * 0.05, 2.5 - 60 * 0.05, 2.5 - 20 * 0.05))
    assert shown.metres_per_px == floor.metres_per_px
    cells[:] = UNKNOWN
    assert floor_only(floor, cells) is floor
