from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.atlas import make_atlas
from ebjax.floors.obstacles import Boxes, no_boxes, no_posts
from ebjax.floors.plan import make_plan
from ebjax.floors.render import Light, Passers
from ebjax.floors.render import render as render_eagerly
from ebjax.floors.scene import make_scene
from ebjax.geometry.camera import backproject, camera_over_floor, project

X_MIN, X_MAX, WIDTH, TEXEL = -2.0, 8.0, 2.4, 0.02
# The gradient's program is run once: not worth optimising.
QUICK = {"xla_backend_optimization_level": 0}
NOBODY = Passers(no_boxes(jnp.float64), no_posts(jnp.float64))
PLAN = make_plan([np.array([[X_MIN + 2, 0.0], [X_MAX - 2, 0.0]])], WIDTH, 2.0)
FLAT = Light(jnp.ones(3), jnp.asarray(0.0), jnp.zeros(2), jnp.asarray(0.0), jnp.zeros(4), jnp.asarray(0.0))


@jax.jit
def render(scene, camera, world_from_base, light, passers=NOBODY):
    return render_eagerly(scene, camera, world_from_base, light, passers)


def pose(x, y, heading):
    c, s = np.cos(heading), np.sin(heading)
    return jnp.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])


def camera(height_m=0.54, pitch=0.33, scale=8):
    return camera_over_floor(
        615 / scale, 615 / scale, 320 / scale, 240 / scale, 640 // scale, 480 // scale, height_m, pitch, 0.02, 0.27
    )


def corridor_of(texture):
    return make_scene(PLAN, make_atlas(np.asarray(texture), [0], PLAN, TEXEL, jnp.float64), 2.4, no_boxes(jnp.float64))


@pytest.fixture(scope="module")
def ramps():
    """A floor whose red is x and whose green is y, over a constant blue."""
    rows, columns = round(WIDTH / TEXEL), round((X_MAX - X_MIN) / TEXEL)
    x, y = X_MIN + (np.arange(columns) + 0.5) * TEXEL, -WIDTH / 2 + (np.arange(rows) + 0.5) * TEXEL
    return corridor_of(np.stack([*np.meshgrid(x, y), np.ones((rows, columns))], axis=-1))


def test_floor_points_land_where_the_camera_projects_them(ramps):
    cam, world_from_base = camera(), pose(1.0, 0.2, 0.15)
    radiance, depth = render(ramps, cam, world_from_base, FLAT)
    # The constant channel divides the shading out; texture filtering keeps a ramp, up to the clamped edges.
    xy = np.asarray(radiance[..., :2] / radiance[..., 2:])
    v, u = np.mgrid[: cam.height, : cam.width]
    near = (np.asarray(depth) < 2.5) & (np.abs(xy[..., 1]) < 0.9)
    world = np.concatenate([xy[near], np.zeros((near.sum(), 1)), np.ones((near.sum(), 1))], axis=1)
    base = world @ np.linalg.inv(np.asarray(world_from_base)).T
    pixels, ahead = project(cam, jnp.asarray(base[:, :3]))
    assert near.mean() > 0.3
    assert np.abs(np.asarray(pixels) - np.stack([u[near], v[near]], axis=1)).max() < 0.05
    np.testing.assert_allclose(ahead, np.asarray(depth)[near], atol=1e-5)


@pytest.mark.parametrize("heading", [0.0, 0.4, 2.0, np.pi])
def test_depth_lifts_every_pixel_onto_a_plane(ramps, heading):
    cam, world_from_base = camera(scale=16), pose(3.0, -0.3, heading)
    _, depth = render(ramps, cam, world_from_base, FLAT)
    v, u = jnp.mgrid[: cam.height, : cam.width]
    pixels = jnp.stack([u.reshape(-1), v.reshape(-1)], axis=1).astype(jnp.float64)
    points = backproject(pixels, depth.reshape(-1), cam.intrinsics)
    x, y, z, _ = (world_from_base @ cam.base_from_camera) @ jnp.concatenate([points, jnp.ones((len(points), 1))], 1).T
    planes = jnp.stack([z, z - 2.6, x - X_MIN, x - X_MAX, y - WIDTH / 2, y + WIDTH / 2])
    assert jnp.all(jnp.isfinite(depth)) and jnp.all(depth > 0)
    assert jnp.abs(planes).min(axis=0).max() < 1e-5
    inside = (x > X_MIN - 1e-5) & (x < X_MAX + 1e-5) & (jnp.abs(y) < WIDTH / 2 + 1e-5) & (z > -1e-5) & (z < 2.6 + 1e-5)
    assert inside.all()


def test_far_floor_does_not_alias():
    rows, columns = round(WIDTH / TEXEL), round((X_MAX - X_MIN) / TEXEL)
    checker = (np.add.outer(np.arange(rows), np.arange(columns)) % 2).astype(np.float32)
    flat, grey = (corridor_of(np.repeat(t[..., None], 3, -1)) for t in (checker, 0 * checker + 0.5))
    cam = camera(scale=4)
    (seen, depth), (expected, _) = (render(c, cam, pose(-1.0, 0.0, 0.03), FLAT) for c in (flat, grey))
    v = jnp.broadcast_to(jnp.arange(cam.height)[:, None], depth.shape)
    far = (depth > 3.0) & (v > 25)
    assert far.sum() > 300
    assert jnp.abs(jnp.where(far[..., None], seen - expected, 0)).max() < 0.05


def test_walls_carry_doors_and_light_changes_the_image(ramps):
    cam = camera(scale=8)
    image, _ = render(ramps, cam, pose(3.6, -0.8, np.pi / 2), FLAT)
    row = image[2, :, 0]
    assert row.max() > 0.5 and row.min() < 0.2, "facing a wall shows plaster and a door"
    dim = replace(FLAT, level=0.5 * jnp.ones(3))
    np.testing.assert_allclose(render(ramps, cam, pose(3.6, -0.8, np.pi / 2), dim)[0], 0.5 * image, atol=1e-12)
    glossy = render(ramps, cam, pose(0.0, 0.0, 0.0), replace(FLAT, gloss=jnp.asarray(1.0)))[0]
    assert jnp.all(glossy >= render(ramps, cam, pose(0.0, 0.0, 0.0), FLAT)[0])


@pytest.mark.slow
def test_differentiable_in_the_camera_and_the_floor(ramps):
    @jax.jit
    def brightness(height_m, pitch, texels):
        texture = replace(ramps.floor.texture, texels=texels)
        scene = replace(ramps, floor=replace(ramps.floor, texture=texture))
        radiance, _ = render_eagerly(scene, camera(height_m, pitch, scale=32), pose(2.0, 0.0, 0.1), FLAT, NOBODY)
        return jnp.mean(radiance[8:] ** 2)

    texels = ramps.floor.texture.texels
    at, eps = (jnp.asarray(0.54), jnp.asarray(0.33), texels), 1e-6
    found = jax.jit(jax.grad(brightness, (0, 1, 2)), compiler_options=QUICK)(*at)
    direction = jnp.asarray(np.random.default_rng(0).normal(size=texels.shape))
    for i, step in enumerate((eps, eps, eps * direction)):
        up, down = (brightness(*(a + s * step if k == i else a for k, a in enumerate(at))) for s in (1, -1))
        slope = jnp.vdot(found[i], step / eps)
        assert float(slope) == pytest.approx(float(up - down) / (2 * eps), rel=1e-5)
    assert jnp.all(jnp.isfinite(found[2])) and abs(float(jnp.vdot(found[2], direction))) > 1e-6


def test_a_batch_is_the_frames_one_by_one(ramps):
    poses = jnp.stack([pose(1.0, 0.2, 0.1), pose(3.0, -0.2, 3.0)])
    cam = camera(scale=16)
    together = jax.jit(jax.vmap(lambda p: render_eagerly(ramps, cam, p, FLAT, NOBODY)))(poses)
    for i, one in enumerate(poses):
        for batched, single in zip(together, render(ramps, cam, one, FLAT), strict=True):
            np.testing.assert_allclose(batched[i], single, atol=1e-9)


def test_each_row_is_seen_from_its_own_pose(ramps):
    cam = camera(scale=16)
    poses = [pose(1.0 + 0.01 * k, 0.2, 0.1 + 0.005 * k) for k in range(cam.height)]
    rolling = render(ramps, cam, jnp.stack(poses), FLAT)
    for k in (0, 7, cam.height // 2, cam.height - 1):
        for whole, row in zip(render(ramps, cam, poses[k], FLAT), rolling, strict=True):
            np.testing.assert_allclose(row[k], whole[k], atol=1e-9)


def test_daylight_reaches_a_limit(ramps):
    sloped = replace(FLAT, slope=jnp.array([0.02, 0.0]))
    floor = replace(ramps.floor, origins=ramps.floor.origins + jnp.array([[500.0, 0.0]]))
    far = replace(ramps, floor=floor, walls=ramps.walls + jnp.array([[[500.0, 0.0]]]))
    plain, lit = (render(far, camera(scale=16), pose(503.0, 0.0, 0.0), light)[0] for light in (FLAT, sloped))
    np.testing.assert_allclose(lit[20:], (1 + 0.02 * 60) * plain[20:])


def test_leaning_pile_is_bright_from_one_side_and_dark_from_the_other():
    shape = round(WIDTH / TEXEL), round((X_MAX - X_MIN) / TEXEL)
    pile = np.concatenate([np.full((*shape, 3), 0.5), np.full((*shape, 1), 0.3), np.zeros((*shape, 1))], axis=-1)
    flat = corridor_of(np.full((*shape, 3), 0.5))
    cam, ratio = camera(scale=16), []
    for heading in (0.0, np.pi):
        leaning, level = (render(s, cam, pose(3.0, 0.0, heading), FLAT) for s in (corridor_of(pile), flat))
        near = level[1] < 1.5
        ratio.append(float((leaning[0][near] / level[0][near]).mean()))
    assert ratio[0] > 1.15 and ratio[0] - 1 == pytest.approx(1 - ratio[1], rel=0.02)


def test_passers_hide_the_floor_at_their_own_depth(ramps):
    table = [[3.0, 0.0]], [[1.0, 0.0]], [[0.2, 0.5]], [0.0], [0.8], [[[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]], [0.3]
    cart = Passers(Boxes(*(jnp.asarray(n, jnp.float64) for n in table)), NOBODY.posts)
    cam = camera(scale=8)
    (free, far), (hidden, near) = (render(ramps, cam, pose(0.0, 0.0, 0.0), FLAT, p) for p in (NOBODY, cart))
    v, u = jnp.mgrid[: cam.height, : cam.width]
    pixels = jnp.stack([u.reshape(-1), v.reshape(-1)], axis=1).astype(jnp.float64)
    points = backproject(pixels, near.reshape(-1), cam.intrinsics)
    x = (cam.base_from_camera[:3, :3] @ points.T + cam.base_from_camera[:3, 3:])[0].reshape(near.shape)
    met = near < far - 1e-9
    on_front = met & (jnp.abs(x - 2.8) < 1e-9)
    assert 0.03 < met.mean() < 0.5
    assert on_front.sum() > 0.8 * met.sum() and jnp.all(hidden[on_front] <= 0.2)
    assert jnp.all(near[~met] == far[~met]) and not jnp.allclose(hidden[~met], free[~met])


def test_dtype_follows_the_inputs(ramps):
    arguments = ramps, camera(scale=32), pose(0, 0, 0), FLAT, NOBODY
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), arguments)
    assert {leaf.dtype for leaf in render(*single)} == {jnp.dtype(jnp.float32)}
