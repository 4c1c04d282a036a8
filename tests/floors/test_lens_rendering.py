from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.atlas import make_atlas
from ebjax.floors.cameras import CameraConfig
from ebjax.floors.obstacles import no_boxes, no_posts
from ebjax.floors.plan import make_plan
from ebjax.floors.rays import bent_rays
from ebjax.floors.render import Light, Passers
from ebjax.floors.render import render as render_eagerly
from ebjax.floors.robot import RobotConfig
from ebjax.floors.scene import make_scene
from ebjax.floors.sensor import SensorConfig
from ebjax.floors.sequence import CorridorConfig, record
from ebjax.floors.surface import FloorConfig
from ebjax.geometry.camera import camera_over_floor, project, raw_from_ideal
from ebjax.geometry.lens import PINHOLE, lens
from ebjax.io.camera_file import CameraFile, read_camera, write_camera
from ebjax.io.logs.open import open_log
from ebjax.worlds.render import render_sequence

X_MIN, X_MAX, WIDTH, TEXEL = -2.0, 8.0, 2.4, 0.02
SHAPE = round(WIDTH / TEXEL), round((X_MAX - X_MIN) / TEXEL)
NOBODY = Passers(no_boxes(jnp.float64), no_posts(jnp.float64))
PLAN = make_plan([np.array([[X_MIN + 2, 0.0], [X_MAX - 2, 0.0]])], WIDTH, 2.0)
FLAT = Light(jnp.ones(3), jnp.asarray(0.0), jnp.zeros(2), jnp.asarray(0.0), jnp.zeros(4), jnp.asarray(0.0))
LENSES = {
    "plumb_bob": lens("plumb_bob", (0.15, -0.3, 0.0008, -0.0006, 0.16)),
    "equidistant": lens("equidistant", (0.045, 0.012, -0.02, 0.006)),
}
STRAIGHT = camera_over_floor(154.0, 154.0, 80.0, 60.0, 160, 120, 0.54, 0.33, 0.02, 0.27)
cast, rays_through = jax.jit(render_eagerly), jax.jit(bent_rays)


def render(scene, camera, world_from_base):
    """One program for all lenses: the rays are what differs."""
    return cast(scene, replace(camera, lens=PINHOLE), world_from_base, FLAT, NOBODY, rays_through(camera))


def pose(x, y, heading):
    c, s = np.cos(heading), np.sin(heading)
    return jnp.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])


def camera(name):
    return replace(STRAIGHT, lens=LENSES[name])


def grid(cam):
    v, u = np.mgrid[: cam.height, : cam.width]
    return jnp.asarray(np.stack([u.ravel(), v.ravel()], axis=1), jnp.float64)


def corridor_of(texture):
    return make_scene(PLAN, make_atlas(np.asarray(texture), [0], PLAN, TEXEL, jnp.float64), 2.4, no_boxes(jnp.float64))


@pytest.fixture(scope="module")
def places():
    """A floor whose red is x and whose green is y, over a constant blue."""
    x, y = X_MIN + (np.arange(SHAPE[1]) + 0.5) * TEXEL, -WIDTH / 2 + (np.arange(SHAPE[0]) + 0.5) * TEXEL
    return corridor_of(np.stack([*np.meshgrid(x, y), np.ones(SHAPE)], axis=-1))


@pytest.fixture(scope="module")
def tiles():
    """Tiles of 20 cm, each of its own grey, with joints; smooth enough for an image to be sampled."""
    row, column = np.arange(SHAPE[0]) // 10, np.arange(SHAPE[1]) // 10
    grey = np.random.default_rng(0).uniform(0.3, 0.8, (row[-1] + 1, column[-1] + 1))[row][:, column]
    grey[np.arange(SHAPE[0]) % 10 == 0] = 0.1
    grey[:, np.arange(SHAPE[1]) % 10 == 0] = 0.1
    return corridor_of(np.repeat(cv2.GaussianBlur(grey, (0, 0), 2.0)[..., None], 3, axis=-1))


@pytest.mark.slow
@pytest.mark.parametrize("name", LENSES)
def test_an_image_that_is_unbent_is_the_pinholes(tiles, name):
    bent = camera(name)
    (expected, deep), (raw, raw_depth) = (render(tiles, c, pose(1.0, 0.1, 0.1)) for c in (STRAIGHT, bent))
    at = np.asarray(raw_from_ideal(bent, grid(bent)), np.float32).reshape(*bent.size, 2)
    unbent, depth = (cv2.remap(np.asarray(a, np.float32), at, None, cv2.INTER_CUBIC) for a in (raw, raw_depth))
    middle = slice(40, 100), slice(30, 130)
    error = np.mean((unbent[middle] - np.asarray(expected)[middle]) ** 2)
    assert -10 * np.log10(error) > 35
    assert np.quantile(np.abs(depth / deep - 1)[middle], 0.99) < 2e-3
    assert np.abs(np.asarray(raw)[middle] - np.asarray(expected)[middle]).max() > 0.1, "the lens does bend"


@pytest.mark.slow
@pytest.mark.parametrize("name", LENSES)
def test_floor_points_land_where_the_lens_shows_them(places, name):
    cam, world_from_base = camera(name), pose(1.0, 0.2, 0.15)
    radiance, depth = map(np.asarray, render(places, cam, world_from_base))
    xy = radiance[..., :2] / radiance[..., 2:]
    v, u = np.mgrid[: cam.height, : cam.width]
    near = (depth < 2.5) & (np.abs(xy[..., 1]) < 0.9)
    world = np.concatenate([xy[near], np.zeros((near.sum(), 1)), np.ones((near.sum(), 1))], axis=1)
    base = world @ np.linalg.inv(np.asarray(world_from_base)).T
    ideal, ahead = project(cam, jnp.asarray(base[:, :3]))
    assert near.mean() > 0.25
    raw = np.asarray(raw_from_ideal(cam, ideal))
    assert np.abs(raw - np.stack([u[near], v[near]], axis=1)).max() < 0.05
    np.testing.assert_allclose(ahead, depth[near], atol=1e-5)


def test_depth_lifts_every_ray_onto_a_plane_and_ends_at_87_degrees(places):
    # The image folds back at 95 degrees: a circle of 50 px.
    wide = STRAIGHT.intrinsics.at[jnp.arange(2), jnp.arange(2)].set(45.0)
    cam = replace(STRAIGHT, intrinsics=wide, lens=lens("equidistant", (-0.1212, 0.0, 0.0, 0.0)))
    radiance, depth = map(np.asarray, render(places, cam, pose(3.0, -0.3, 0.4)))
    radius, at_87 = np.linalg.norm(np.asarray(grid(cam)) - [80.0, 60.0], axis=1).reshape(cam.size), np.arccos(0.05)
    shown, ahead = radius <= 49.74, radius <= 45 * at_87 * (1 - 0.1212 * at_87**2)
    assert 0.3 < shown.mean() < 0.9 and (shown & ~ahead).any()
    assert np.all(radiance[~shown] == 0) and np.all(radiance[shown].max(axis=-1) > 0)
    assert np.all(depth[~ahead] == 0) and np.all(depth[ahead] > 0)
    points = np.asarray(rays_through(cam).directions)[:, ahead] * depth[ahead]
    points = np.concatenate([points, np.ones_like(points[:1])])
    x, y, z, _ = pose(3.0, -0.3, 0.4) @ cam.base_from_camera @ points
    planes = jnp.stack([z, z - 2.6, x - X_MIN, x - X_MAX, y - WIDTH / 2, y + WIDTH / 2])
    assert jnp.abs(planes).min(axis=0).max() < 1e-5


def test_far_floor_does_not_alias_behind_a_lens():
    checker = (np.add.outer(np.arange(SHAPE[0]), np.arange(SHAPE[1])) % 2).astype(np.float32)
    flat, grey = (corridor_of(np.repeat(t[..., None], 3, -1)) for t in (checker, 0 * checker + 0.5))
    cam = camera("equidistant")
    (seen, depth), (expected, _) = (render(c, cam, pose(-1.0, 0.0, 0.03)) for c in (flat, grey))
    v = jnp.broadcast_to(jnp.arange(cam.height)[:, None], depth.shape)
    far = (depth > 3.0) & (v > 25)
    assert far.sum() > 300
    assert jnp.abs(jnp.where(far[..., None], seen - expected, 0)).max() < 0.05


@pytest.mark.parametrize("name", LENSES)
def test_steps_are_the_differences_of_neighbouring_rays(name):
    rays = rays_through(camera(name))
    across, down = (jnp.diff(rays.directions, axis=axis) for axis in (2, 1))
    between = (
        (rays.steps[0, :, :, 1:] + rays.steps[0, :, :, :-1]) / 2,
        (rays.steps[1, :, 1:] + rays.steps[1, :, :-1]) / 2,
    )
    np.testing.assert_allclose(across, between[0], atol=2e-5)
    np.testing.assert_allclose(down, between[1], atol=2e-5)
    assert rays.shown.all() and rays.ahead.all()


@pytest.mark.slow
def test_rays_of_a_pinhole_and_rays_of_the_frame_itself_are_the_same(places):
    for cam in (STRAIGHT, camera("plumb_bob")):
        own = cast(places, cam, pose(1, 0, 0), FLAT, NOBODY)
        for a, b in zip(own, render(places, cam, pose(1, 0, 0)), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9)


def test_each_row_is_seen_through_the_lens_from_its_own_pose(places):
    cam = camera("equidistant")
    poses = [pose(1.0 + 0.01 * k, 0.2, 0.1 + 0.005 * k) for k in range(cam.height)]
    rolling = render(places, cam, jnp.stack(poses))
    for k in (0, 31, cam.height - 1):
        for whole, row in zip(render(places, cam, poses[k]), rolling, strict=True):
            np.testing.assert_allclose(row[k], whole[k], atol=1e-9)


@pytest.mark.slow
def test_rays_are_differentiable_in_the_lens():
    weights = jnp.asarray(np.random.default_rng(0).normal(size=(3, 120, 160)))

    def score(coefficients):
        cam = replace(STRAIGHT, lens=replace(LENSES["equidistant"], coefficients=coefficients))
        return jnp.vdot(weights, bent_rays(cam).directions)

    at, eps = jnp.asarray(LENSES["equidistant"].coefficients), 1e-6
    step = eps * jnp.array([1.0, -0.5, 0.3, 0.2])
    value = jax.jit(score)
    slope = float(jnp.vdot(jax.jit(jax.grad(score))(at), step / eps))
    assert slope == pytest.approx(float(value(at + step) - value(at - step)) / (2 * eps), rel=1e-5)


@pytest.fixture(scope="module")
def wide(any_floor):
    return CorridorConfig(
        floor=FloorConfig(texel_m=0.02),
        robot=RobotConfig(distance_m=1.0, step_m=0.5, turn_step_deg=90.0, passes=1, nod_deg=2.0),
        camera=CameraConfig("gopro-wide", width=96),
        sensor=SensorConfig(readout_s=0.03),
    )


@pytest.mark.slow
def test_a_run_through_a_lens_is_a_function_of_the_seed(wide):
    one, two, other = record(wide), record(wide), record(replace(wide, seed=1))
    for a, b in zip(one.frame(1), two.frame(1), strict=True):
        assert np.all(a == b)
    assert np.abs(one.frame(1)[0].astype(int) - other.frame(1)[0]).mean() > 3
    assert {leaf.dtype for leaf in jax.tree.leaves(one.camera)} == {np.dtype(np.float32)}
    rgb, depth = one.frame(1)
    assert rgb.shape == (72, 96, 3) and rgb.min(axis=(0, 1)).max() < 200 and np.mean(depth > 0) > 0.5


@pytest.mark.slow
def test_a_camera_file_and_a_bag_go_through_the_command(wide, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "ebjax.floors.sequence._see",
        lambda scene, camera, *rest: (jnp.full((*camera.size, 3), 0.5), jnp.full(camera.size, 2.0)),
    )
    file = CameraFile(
        intrinsics=np.array([[60.0, 0.0, 47.0], [0.0, 61.0, 36.0], [0.0, 0.0, 1.0]]),
        base_from_camera=np.array([[0, -0.6, 0.8, 0.3], [-1, 0, 0, 0.05], [0, -0.8, -0.6, 0.7], [0, 0, 0, 1.0]]),
        width=96,
        height=72,
        depth_scale=1000.0,
        distortion_model="plumb_bob",
        distortion=(0.15, -0.3, 0.0008, -0.0006, 0.16),
    )
    write_camera(tmp_path / "mine.json", file)
    config = replace(wide, camera=CameraConfig(file=tmp_path / "mine.json"))
    with pytest.raises(ValueError, match=r"^camera\.file is"):
        record(config)
    out = tmp_path / "run"
    render_sequence(config, out)
    render_sequence(config, out, "mcap")
    written, log = read_camera(out / "camera.json"), open_log(out / "run.mcap")
    for found in (written, log.camera):
        np.testing.assert_allclose(found.intrinsics, file.intrinsics, atol=1e-5)
        np.testing.assert_allclose(found.base_from_camera, file.base_from_camera, atol=1e-6)
        assert (found.width, found.height, found.distortion_model) == (96, 72, "plumb_bob")
        assert found.distortion == file.distortion
    at_once = tmp_path / "at_once"
    render_sequence(config, at_once, "mcap")
    files = sorted(p.relative_to(out) for p in out.rglob("*") if p.is_file())
    assert all((at_once / f).read_bytes() == (out / f).read_bytes() for f in files)
