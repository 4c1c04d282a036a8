from dataclasses import replace

import numpy as np
import pytest

from ebjax.floors.furniture import furnish
from ebjax.floors.passers import PassersConfig, at_frame, check, plan_walks
from ebjax.floors.plan import make_plan
from ebjax.floors.robot import RobotConfig, drive

POSES, _ = drive(replace(RobotConfig(), distance_m=40.0), np.random.default_rng(0))


def walks(share, seed=0):
    return plan_walks(POSES, 0.5, 1.2, PassersConfig(share=share), np.random.default_rng(seed))


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_somebody_is_there_as_often_as_asked(share):
    met = [sum(walk.last - walk.first for walk in walks(share, seed)) / len(POSES) for seed in range(20)]
    assert np.mean(met) == pytest.approx(share, abs=0.35 * share)


def test_passers_walk_ahead_between_the_walls():
    moving = walks(0.5)
    assert [w.first for w in moving] == [w.first for w in walks(0.5)]
    shapes = set()
    for i in range(len(POSES)):
        now = at_frame(moving, POSES, i)
        shapes.add((now.boxes.centres.shape, now.posts.centres.shape))
        there = np.asarray(now.posts.radii) > 0
        assert there.any() == any(w.first <= i < w.last for w in moving)
        if there.any():
            offset = np.asarray(now.posts.centres)[there] - POSES[i, :2]
            ahead = offset @ [np.cos(POSES[i, 2]), np.sin(POSES[i, 2])]
            assert np.all((ahead > 0.1) & (ahead < 9))
    assert len(shapes) == 1


def test_passers_stay_ahead_of_a_robot_that_backs_away():
    poses, passes = drive(replace(RobotConfig(), distance_m=40.0, reverse=True), np.random.default_rng(0))
    met = plan_walks(poses, 0.5, 1.2, PassersConfig(share=0.5), np.random.default_rng(0))
    back = [walk for walk in met if passes[walk.first] == 1]
    assert back and all(np.all((walk.ahead_m > 0.6) & (walk.ahead_m < 8)) for walk in back)
    # Who follows is left behind no longer: the robot comes away from everybody.
    followers = [walk for walk in back if walk.ahead_m[0] < 2 and len(walk.ahead_m) > 2]
    assert followers and all(np.all(np.diff(walk.ahead_m) > 0.5) for walk in followers)


def test_nobody_costs_nothing():
    assert walks(0.0) == [] and len(at_frame([], POSES, 0).boxes.centres) == 0


def test_furniture_stands_along_the_walls():
    plan = make_plan([np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0]])], 2.8, 1.0)
    boxes, paints = furnish(plan, 0.6, np.random.default_rng(0))
    centres = np.asarray(boxes.centres, np.float64)
    assert len(centres) > 10 and len(np.unique(paints, axis=0)) > 2
    assert plan.inside(centres).any(axis=0).all()
    to_route = np.minimum(
        np.hypot(centres[:, 0] - np.clip(centres[:, 0], 0, 10), centres[:, 1]),
        np.hypot(centres[:, 0] - 10, centres[:, 1] - np.clip(centres[:, 1], 0, 8)),
    )
    assert to_route.min() > 0.75, "out of the robot's way"
    assert len(furnish(plan, 0.0, np.random.default_rng(0))[0].centres) == 0


@pytest.mark.parametrize("key, value", [("share", 2.0), ("carts", -0.1), ("speed_mps", 0.0)])
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"passers.{key} is"):
        check(replace(PassersConfig(), **{key: value}))
