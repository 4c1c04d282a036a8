import cv2
import matplotlib
import numpy as np
import pytest

from ebjax.viz import figures


def decode(png):
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.std() > 5
    return image[..., ::-1].astype(int)


def has_colour(image, colour):
    rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    return (np.abs(image - rgb).sum(-1) < 30).sum() > 20


def corridor(offset, sway=0.0):
    out = np.linspace(0, 20, 40)
    x = np.concatenate([out, out[::-1]])
    return np.stack([x, np.concatenate([np.zeros(40), np.full(40, offset)]) + sway * (20 - x)], axis=1)


@pytest.fixture(autouse=True)
def no_global_state():
    before = matplotlib.rcParams["backend_fallback"], matplotlib.rcParams._get("backend")
    yield
    assert before == (matplotlib.rcParams["backend_fallback"], matplotlib.rcParams._get("backend"))
    import sys

    assert "matplotlib.pyplot" not in sys.modules


def test_trajectory_draws_every_path_and_the_loops():
    loops = np.array([[5, 74], [20, 59]])
    image = decode(figures.trajectory(corridor(0.25, 0.05), corridor(0.25), corridor(0.25) + 0.01, loops))
    assert all(has_colour(image, c) for c in (figures.BEFORE, figures.AFTER, figures.LOOP))


@pytest.mark.parametrize("heading", [0.0, 1.1, np.pi, -2.0])
def test_a_thin_corridor_is_laid_along_x(heading):
    c, s = np.cos(heading), np.sin(heading)
    path = corridor(0.25) @ np.array([[c, s], [-s, c]])
    turned = path @ figures._along_x(path).T
    np.testing.assert_allclose(turned, corridor(0.25), atol=0.3)


def test_trajectory_without_truth_or_loops_and_with_gaps_in_the_truth():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    decode(figures.trajectory(square, square))
    gaps = square.copy()
    gaps[0] = np.nan
    decode(figures.trajectory(square, square, gaps, np.array([[0, 3]])))
    decode(figures.trajectory(square[:1], square[:1], square[:1]))


def test_candidates_with_and_without_a_matrix():
    pairs, scores = np.array([[0, 9], [3, 7]]), np.array([0.4, 0.9])
    matrix = np.full((10, 10), np.nan)
    matrix[9, 0] = 0.4
    decode(figures.candidates(pairs, scores, np.array([False, True]), 10, matrix))
    decode(figures.candidates(pairs[:0], scores[:0], np.zeros(0, bool), 10))


def test_matches_turn_the_second_image_and_its_points():
    a, b = np.full((60, 80, 3), 90, np.uint8), np.full((40, 80, 3), 90, np.uint8)
    b[:10, :20] = (255, 0, 0)
    points = np.array([[10.0, 10.0], [30.0, 20.0], [70.0, 30.0]])
    plain = decode(figures.matches(a, b, points, points, np.array([True, True, False]), title="1_a and $b"))
    turned = decode(figures.matches(a, b, points, points, np.array([True, True, False]), turn_second=True))
    red = [np.argwhere((i[..., 0] > 240) & (i[..., 1] < 20)).mean(0) for i in (plain, turned)]
    assert red[1][0] > red[0][0] and red[1][1] > red[0][1]
    decode(figures.matches(a, b, points[:0], points[:0], np.zeros(0, bool)))


def test_floor_map_shows_the_mosaic_and_the_path():
    mosaic = np.zeros((30, 100, 4), np.uint8)
    mosaic[5:25] = (200, 120, 40, 255)
    extent = (0.0, 20.0, -3.0, 3.0)
    bare = decode(figures.floor_map(mosaic, extent))
    drawn = decode(figures.floor_map(mosaic, extent, corridor(0.5), np.array([[5, 74]])))
    assert has_colour(bare, "#c87828") and bare.shape == drawn.shape
    assert 500 < np.any(bare != drawn, axis=-1).sum() < 0.1 * bare[..., 0].size


def test_same_input_same_bytes():
    assert figures.trajectory(corridor(0.2), corridor(0.2)) == figures.trajectory(corridor(0.2), corridor(0.2))
