"""Floors drawn in the world, and what is mirrored drawn in the view, which the robot takes along."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.camera import FloorView
from ebjax.slam.mirrored import agreement, mirroring, told
from ebjax.views.run_view import RunView

RNG = np.random.default_rng(3)
VIEW = FloorView(0.5, 1.7, -0.6, 0.6, 0.01)
FLOOR = np.ones(VIEW.size, bool)
FLOOR[-30:, :15] = False


def texture(size):
    noise = cv2.GaussianBlur(RNG.standard_normal(size).astype(np.float32), (0, 0), 2)
    return noise / noise.std()


WORLD, ROOM = texture((400, 1400)), texture(VIEW.size)


def view_at(x, mirrored):
    """Of a robot that drives along x: its floor, and the room in it."""
    rows = slice(140, 140 + VIEW.size[0])
    # The far end is the first row: the floor moves down the view.
    strip = np.rot90(WORLD[rows, round(100 * x) : round(100 * x) + VIEW.size[1]])
    grey = 128 + 25 * (strip * (1 - mirrored) + ROOM * mirrored)
    return np.repeat(grey.clip(0, 255).astype(np.uint8)[..., None], 3, 2)


def found(mirrored, steps=12, step_m=0.15):
    x = step_m * np.arange(steps)
    view = RunView(jnp.eye(3), jnp.asarray(VIEW.floor_from_view), jnp.asarray(FLOOR))
    return mirroring(view, np.stack([x, 0 * x, 0 * x], 1), lambda k: (view_at(x[k], mirrored), FLOOR))


def test_a_matt_floor_moves_as_the_robot_does():
    on_floor, with_robot = found(0.0)
    assert on_floor > 0.9 and abs(with_robot) < 0.2
    assert told((on_floor, with_robot)) is None


def test_a_wrong_mount_is_no_mirror():
    assert told((0.1, 0.3)) is None and told((0.1, 0.5)) is not None


def test_streaks_along_the_way_agree_with_both():
    assert told((0.7, 0.4)) is not None and told((0.9, 0.4)) is None and told((0.95, 0.25)) is None


def test_a_mirror_stays_with_the_robot():
    on_floor, with_robot = found(0.8)
    assert with_robot > 0.7 and on_floor < 0.4
    said = told((on_floor, with_robot))
    assert said.startswith(f"the floor mirrors the room: views agree as they stand ({with_robot:.2f}), not only where")


@pytest.mark.parametrize("changes", [{"steps": 3}, {"steps": 1}, {"step_m": 0.0}, {"step_m": 1.0}])
def test_too_few_steps_tell_nothing(changes):
    assert found(0.8, **changes) is None and told(None) is None


def test_views_without_common_floor_tell_nothing():
    here, there = FLOOR.copy(), FLOOR.copy()
    here[:60], there[60:] = False, False
    assert agreement((view_at(0, 0.5),) * 2, (here, there), np.eye(3)) is None
