from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.atlas import make_atlas
from ebjax.floors.obstacles import Boxes, no_boxes, no_posts
from ebjax.floors.plan import PlanConfig, make_plan
from ebjax.floors.ramp import CASTER_M, make_ramp, stand
from ebjax.floors.render import Light, Passers
from ebjax.floors.render import render as render_eagerly
from ebjax.floors.scene import make_scene
from ebjax.geometry.camera import backproject, camera_over_floor

FLAT = Light(jnp.ones(3), jnp.asarray(0.0), jnp.zeros(2), jnp.asarray(0.0), jnp.zeros(4), jnp.asarray(0.0))
PLAN = make_plan([np.array([[0.0, 0.0], [8.0, 0.0]])], 2.4, 2.0)
CAMERA = camera_over_floor(77.0, 77.0, 40.0, 30.0, 80, 60, 0.54, 0.33, 0.0, 0.27)
TABLE = [[4.8, 0.0]], [[1.0, 0.0]], [[0.1, 0.3]], [0.0], [0.4], [[[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]], [0.3]
CART = Passers(Boxes(*(jnp.asarray(n, jnp.float64) for n in TABLE)), no_posts(jnp.float64))
NOBODY = replace(CART, boxes=replace(CART.boxes, halves=jnp.zeros((1, 2))))
UP, DOWN = (make_ramp(PlanConfig(ramp="3 0, 5 0", ramp_deg=a)) for a in (8.0, -8.0))
TEXEL = 0.02
render = jax.jit(render_eagerly)


def scene(ramp):
    """A floor whose red is x and whose green is y, over a constant blue."""
    x, y = -2.0 + (np.arange(600) + 0.5) * TEXEL, -1.2 + (np.arange(120) + 0.5) * TEXEL
    image = np.stack([*np.meshgrid(x, y), np.ones((120, 600))], axis=-1)
    return make_scene(PLAN, make_atlas(image, [0], PLAN, TEXEL, jnp.float64), 2.4, no_boxes(jnp.float64), ramp=ramp)


def lifted(pose, depth):
    v, u = jnp.mgrid[: CAMERA.height, : CAMERA.width]
    pixels = jnp.stack([u.reshape(-1), v.reshape(-1)], axis=1).astype(jnp.float64)
    points = backproject(pixels, depth.reshape(-1), CAMERA.intrinsics)
    return ((pose @ CAMERA.base_from_camera) @ jnp.concatenate([points, jnp.ones((len(points), 1))], 1).T)[:3]


@pytest.mark.slow
@pytest.mark.parametrize("ramp", [UP, DOWN])
@pytest.mark.parametrize("x, heading", [(1.0, 0.0), (2.9, 0.0), (3.1, 0.2), (4.0, 2.0), (4.8, 0.0), (7.0, np.pi)])
def test_every_pixel_lies_on_the_inclined_floor_the_ceiling_above_it_or_a_wall(ramp, x, heading):
    pose = jnp.asarray(stand(np.array([x, 0.1, heading]), ramp))
    radiance, depth = render(scene(ramp), CAMERA, pose, FLAT, NOBODY)
    x, y, z = (n.reshape(depth.shape) for n in lifted(pose, depth))
    above = z - ramp.height(x, y)
    assert jnp.all(jnp.isfinite(depth)) and jnp.all(depth > 0)
    planes = jnp.stack([above, above - 2.6, x + 2, x - 10, y - 1.2, y + 1.2])
    assert jnp.abs(planes).min(axis=0).max() < 2e-4
    assert above.min() > -2e-4 and above.max() < 2.6 + 2e-4
    floor = (jnp.abs(above) < 1e-9) & (depth < 2.5) & (jnp.abs(y) < 0.9)
    seen = radiance[..., :2] / radiance[..., 2:]
    assert floor.sum() > 100 and jnp.abs(seen - jnp.stack([x, y], axis=-1))[floor].max() < 0.03


def test_things_stand_on_the_inclined_floor():
    pose = jnp.asarray(stand(np.array([3.6, 0.0, 0.0]), UP))
    (_, hidden), (_, free) = (render(scene(UP), CAMERA, pose, FLAT, passers) for passers in (CART, NOBODY))
    x, y, z = lifted(pose, hidden)
    front = (hidden < free).reshape(-1) & (jnp.abs(x - 4.7) < 1e-6)
    floor = UP.height(4.8, 0.0)
    assert front.sum() > 100 and jnp.abs(y[front]).max() < 0.3 + 1e-6
    assert floor - 0.01 < z[front].min() < floor + 0.02 and floor + 0.35 < z[front].max() < floor + 0.4 + 1e-6


def test_a_top_above_the_camera_hides_the_floor_behind_it():
    pose, steep = jnp.asarray(stand(np.array([1.5, 0.0, 0.0]), UP)), replace(UP, slope=np.asarray(0.3))
    for ramp, seen in ((steep, False), (DOWN, True)):
        x, _, z = lifted(pose, render(scene(ramp), CAMERA, pose, FLAT, NOBODY)[1])
        assert jnp.any((x > 5.05) & (jnp.abs(z - ramp.height(6.0, 0.0)) < 1e-6)) == seen


def test_a_robot_stands_on_wheels_and_caster():
    x = np.linspace(2.0, 6.0, 401)
    poses = np.stack([x, 0 * x, 0 * x], axis=1)
    matrices = stand(poses, UP)
    pitch = np.degrees(np.arcsin(matrices[:, 2, 0]))
    np.testing.assert_allclose(np.linalg.det(matrices[:, :3, :3]), 1.0)
    np.testing.assert_allclose(
        matrices[:, :3, :3] @ matrices[:, :3, :3].swapaxes(1, 2), np.eye(3)[None] + 0 * matrices[:, :3, :3], atol=1e-12
    )
    np.testing.assert_allclose(matrices[:, :3, 3], np.stack([x, 0 * x, UP.height(x, 0 * x)], axis=1))
    on_ramp, level = (x > 3 + CASTER_M) & (x < 5), (x < 3) | (x > 5 + CASTER_M)
    np.testing.assert_allclose(pitch[on_ramp], 8.0)
    np.testing.assert_allclose(pitch[level], 0.0, atol=1e-9)
    half_way = np.argmin(np.abs(x - 3 - CASTER_M / 2))
    assert 3.5 < pitch[half_way] < 4.5 and np.all(np.diff(pitch[(x > 3) & (x < 3.2)]) > 0)
    across = stand(np.array([4.0, 0.0, np.pi / 2]), UP)
    assert across[2, 0] == pytest.approx(0) and np.degrees(np.arcsin(across[2, 1])) == pytest.approx(-8.0)
    assert np.all(stand(poses, None)[:, 2, :3] == [0, 0, 1])


def test_a_row_of_poses_stands_as_each_alone():
    poses = np.array([[[2.9, 0.1, 0.3], [3.1, 0.2, 2.0]]])
    for ramp in (UP, None):
        assert np.all(stand(poses, ramp)[0, 1] == stand(poses[0, 1], ramp))


@pytest.mark.parametrize(
    "key, value",
    [
        ("ramp", "3 0"),
        ("ramp", "3 0, 5 0, 6 0"),
        ("ramp", ""),
        ("ramp_deg", 30.0),
        ("ramp_deg", np.nan),
        ("ramp_deg", 0.0),
    ],
)
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"plan.{key} is"):
        make_ramp(replace(PlanConfig(ramp="3 0, 5 0", ramp_deg=5.0), **{key: value}))
