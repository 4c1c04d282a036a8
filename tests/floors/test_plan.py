import numpy as np
import pytest

from ebjax.floors.plan import make_plan, polyline


def perimeter(plan):
    return np.linalg.norm(plan.walls[:, 1] - plan.walls[:, 0], axis=1).sum()


def lines(*texts):
    return [polyline(text, "plan.corridors[0]") for text in texts]


@pytest.mark.parametrize(
    "texts, expected",
    [
        (["0 0, 10 0"], 2 * 14 + 2 * 2),
        (["0 0, 10 0, 10 8"], 4 * 0.5 * (13 + 11) + 2 * 0),
        (["0 0, 10 0, 10 8, 0 8, 0 0"], 2 * (12 + 10) + 2 * (8 + 6)),
        (["0 0, 20 0", "10 0, 10 8"], 2 * 24 + 2 * 2 - 2 + 2 * 9 + 2),
        (["0 0, 20 0", "10 -8, 10 8"], 2 * 24 + 2 * 2 - 4 + 4 * 9 + 4),
    ],
)
def test_walls_go_around_the_corridors(texts, expected):
    assert perimeter(make_plan(lines(*texts), 2.0, 2.0)) == pytest.approx(expected, abs=0.02)


def test_the_floor_lies_left_of_every_wall_and_walls_are_closed():
    plan = make_plan(lines("0 0, 14 0, 14 10, 0 10, 0 0", "7 0, 7 10", "3 0, -3 -7"), 2.0, 2.0)
    start, end = plan.walls[:, 0], plan.walls[:, 1]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    middle = (start + end) / 2
    assert plan.inside(middle + 1e-3 * left).any(axis=0).all()
    assert not plan.inside(middle - 1e-3 * left).any(axis=0).any()
    to_ends = np.linalg.norm(end[:, None] - start[None], axis=-1).min(axis=1)
    assert to_ends.max() < 1e-4, "each wall goes on where another one begins"


def test_rectangles_own_their_floor_once():
    plan = make_plan(lines("0 0, 20 0", "10 -8, 10 8"), 2.0, 2.0)
    points = np.random.default_rng(0).uniform([-3, -11], [23, 11], (500, 2))
    own = np.stack([plan.owns(i, points) & plan.inside(points)[i] for i in range(2)])
    assert np.all(own.sum(axis=0) == plan.inside(points).any(axis=0))


@pytest.mark.parametrize("text", ["", "1 2", "0 0, 1", "0 0, a b", "0 0, 0 0.05", "0 0, nan 1"])
def test_a_bad_polyline_names_its_key(text):
    with pytest.raises(ValueError, match=r"plan.corridors\[3\] is"):
        polyline(text, "plan.corridors[3]")
