"""The differentiable path on a small rendered run: its gradient against central differences, its parts."""

from dataclasses import replace
from functools import cache, partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from ebjax.evaluation.trajectory import ate
from ebjax.geometry.camera import (
    FloorView,
    camera_over_floor,
    ideal_from_raw,
    image_from_floor,
    image_from_view,
    raw_from_ideal,
)
from ebjax.geometry.homography import adjugate, apply
from ebjax.geometry.lens import PINHOLE, lens
from ebjax.geometry.mount import Mounting, remounted
from ebjax.geometry.optics import Optics, unchanged, with_optics
from ebjax.geometry.warp import sample_bilinear
from ebjax.models.layers import Conv, normalise
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.soft import Parameters, Softness, SoftRun, Words, ate_rmse_m, correct, describe
from ebjax.slam.soft_look import network_look, rootsift_look
from ebjax.slam.soft_pairs import chain_of, choose_pairs, choose_points

FLOOR = FloorView(0.95, 1.99, -0.52, 0.52, 0.02)
WORLD = FloorView(-2.0, 5.5, -2.0, 2.0, 0.01)
WRONG = Mounting(*(jnp.asarray(v) for v in (np.radians(3.0), np.radians(1.0), 0.05)))
NONE = Mounting(*(jnp.zeros(()),) * 3)
CLOSE = 1e-4
"""The largest difference of a slope and its central difference, as a share of it."""


LENSES = {
    "pinhole": PINHOLE,
    "plumb_bob": lens("plumb_bob", [-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    "equidistant": lens("equidistant", [0.03, -0.01, 0.004, -0.001]),
}


@cache
def driven(model):
    """30 frames: 3 m out, a turn, and back over a floor of smooth noise; no walls. Odometry drifts."""
    rng = np.random.default_rng(0)
    x, turns = np.linspace(0, 3, 12), np.pi * np.arange(1, 7) / 7
    out = np.stack([x, 0 * x, 0 * x], 1)
    back = np.stack([x[::-1], 0.1 * np.sin(x), 0 * x + np.pi], 1)
    truth = np.concatenate([out, np.stack([0 * turns + x[-1], 0 * turns, turns], 1), back])
    camera = camera_over_floor(154.0, 154.0, 79.5, 59.5, 160, 120, 0.54, np.radians(19.0), 0.0, 0.27)
    camera = replace(camera, lens=LENSES[model])
    paint = cv2.GaussianBlur(rng.normal(size=WORLD.size), (0, 0), 3.0)
    paint = jnp.asarray(0.5 + 0.15 * paint / paint.std())[..., None]
    paint_from_world, floor_from_image = np.linalg.inv(WORLD.floor_from_view), jnp.linalg.inv(image_from_floor(camera))
    raw = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), -1).reshape(-1, 2)
    ideal = ideal_from_raw(camera, raw)

    def photograph(x, y, heading):
        c, s = np.cos(heading), np.sin(heading)
        world_from_floor = np.array([[c, -s, x], [s, c, y], [0, 0, 1]])
        there = apply(paint_from_world @ world_from_floor @ floor_from_image, ideal)
        return sample_bilinear(paint, there).reshape(120, 160, 1)

    images = jnp.stack([photograph(*pose) for pose in truth])
    step = np.diff(truth[:, :2], axis=0)
    bend = np.cumsum(np.append(0, np.linalg.norm(step, axis=1))) * 0.04
    c, s = np.cos(bend[:-1]), np.sin(bend[:-1])
    counted = np.stack([c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]], 1)
    odometry = np.concatenate([np.cumsum(np.append([[0, 0]], counted, 0), 0), truth[:, 2:] + bend[:, None]], 1)
    chain = chain_of(odometry, WheelErrors())
    return SoftRun(images, 0.5 * jnp.arange(30.0), chain, camera, jnp.asarray(truth[:, :2]))


@pytest.fixture(scope="module")
def run():
    """The drive with a pinhole."""
    return driven("pinhole")


def words(channels, clusters=6):
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(clusters, channels)) / np.sqrt(channels)
    assignment = 4 * rng.normal(size=(channels, clusters)) / np.sqrt(channels)
    return Words(*map(jnp.asarray, (centres, assignment, np.zeros(clusters), 0.6)))


class Small(nnx.Module):
    """Two convolutions, symmetric about their cells."""

    def __init__(self, rngs):
        self.first = Conv(1, 6, 4, stride=2, padding=1, rngs=rngs)
        self.second = Conv(6, 12, 4, stride=2, padding=1, rngs=rngs)

    def __call__(self, x):
        return self.second(jnp.tanh(self.first(x - 0.5)))


def patches(weights, view, seen, points):
    """A look that costs little: the grey values around a point."""
    del weights, seen
    around = jnp.asarray([[0, 0], [3, 0], [-3, 0], [0, 3], [0, -3], [2, 2], [-2, -2], [2, -2], [-2, 2]], float)
    straight = sample_bilinear(view, points[:, None] + around[None])[..., 0] - 0.5
    turned = sample_bilinear(view, points[:, None] - around[None])[..., 0] - 0.5
    return normalise(jnp.stack([straight, turned]))


def slopes_and_differences(run, at, softness):
    """Yields every number of the parameters by name, the derivative of the ATE, and what central differences say.

    Bilinear reads have kinks, and the solver's rounding drowns small steps: of up to three steps the one that agrees
    best.
    """
    points = choose_points(at, run, softness)
    pairs = choose_pairs(at, run, points, softness, gap_s=3.0, gap_m=4.0)
    assert np.all(np.asarray(pairs.i) > np.asarray(pairs.j)) and pairs.opposing.any()

    @jax.jit
    @jax.value_and_grad
    def descend(parameters, run, points, pairs):  # as constants of the program they would be compiled
        return ate_rmse_m(correct(parameters, run, points, pairs, softness).poses, run.truth)

    gradient, rng = descend(at, run, points, pairs)[1], np.random.default_rng(1)
    leaves, tree = jax.tree.flatten(at)
    names = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(at)]
    optics = 2e-6 / shifts(run.camera, at.optics, points.keypoints)
    for k, (leaf, slope) in enumerate(zip(leaves, jax.tree.leaves(gradient), strict=True)):
        if "optics" in names[k]:
            steps = np.diag(optics[4:] if "coefficients" in names[k] else optics[:4])
        else:
            steps = [(3e-8 if "mounting" in names[k] else 1e-5) * (rng.normal(size=leaf.shape) if leaf.ndim else 1.0)]
        for step in steps:
            exact, found = float(np.sum(np.asarray(slope) * step)), []
            for e in (1.0, 0.3, 3.0):
                moved = (jnp.asarray(np.asarray(leaf) + way * step) for way in (e, -e))
                there = (jax.tree.unflatten(tree, [*leaves[:k], one, *leaves[k + 1 :]]) for one in moved)
                ahead, behind = (float(descend(other, run, points, pairs)[0]) for other in there)
                found.append((ahead - behind) / (2 * e))
                if abs(found[-1] - exact) < CLOSE * abs(found[-1]):
                    break
            yield names[k], exact, min(found, key=lambda number, exact=exact: abs(number - exact))


@pytest.mark.slow
def test_one_gradient_from_the_ate_to_everything():
    run = driven("plumb_bob")
    run = replace(run, camera=remounted(run.camera, WRONG))
    graph, state = nnx.split(Small(nnx.Rngs(0)))
    softness = Softness(FLOOR, network_look(graph), stride_m=0.08, points=100, rtol=1e-22, max_steps=300)
    weights = jax.tree.map(lambda leaf: leaf.astype(jnp.float64), state)
    optics = Optics(jnp.array([2.03, -0.97, 1.37, -1.21]), 0.1 * jnp.asarray(run.camera.lens.coefficients))
    checked = list(slopes_and_differences(run, Parameters(NONE, words(12), weights, optics), softness))
    assert len(checked) == 3 + 4 + 4 + 4 + 5
    for name, exact, numeric in checked:
        assert exact == pytest.approx(numeric, rel=CLOSE), name


@pytest.mark.slow
def test_the_gradient_by_a_fisheye():
    run = driven("equidistant")
    softness = Softness(FLOOR, patches, stride_m=0.08, points=100, rtol=1e-22, max_steps=300)
    optics = Optics(jnp.array([2.03, -0.97, 1.37, -1.21]), 0.1 * jnp.asarray(run.camera.lens.coefficients))
    checked = list(slopes_and_differences(run, Parameters(NONE, words(9), None, optics), softness))
    assert len(checked) == 3 + 4 + 4 + 4
    for name, exact, numeric in checked:
        assert exact == pytest.approx(numeric, rel=CLOSE), name


def shifts(camera, optics, pixels):
    """How far one unit of each number of the optics moves raw pixels, px rms."""
    ideal = ideal_from_raw(with_optics(camera, optics), pixels)
    flat = jnp.concatenate([optics.intrinsics, optics.coefficients])
    moved = jax.jit(jax.jacfwd(lambda f: raw_from_ideal(with_optics(camera, Optics(f[:4], f[4:])), ideal)))(flat)
    return np.sqrt(np.mean(np.asarray(moved) ** 2, (0, 1)))


@pytest.mark.slow
def test_rootsift_closes_the_loops_with_the_right_camera(run):
    single = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), (run.images, words(256)))
    run, at = replace(run, images=single[0]), Parameters(NONE, single[1])
    softness = Softness(FLOOR, rootsift_look(FLOOR.metres_per_px), exact=False)
    points = choose_points(at, run, softness)
    pairs = choose_pairs(at, run, points, softness, gap_s=3.0, gap_m=4.0)
    corrected = correct(at, run, points, pairs, softness)
    before, after = (float(ate_rmse_m(poses, run.truth)) for poses in (jnp.asarray(run.chain.poses), corrected.poses))
    flat = lambda xy: np.concatenate([np.asarray(xy), np.zeros((30, 1))], 1)  # noqa: E731
    assert after == pytest.approx(ate(flat(run.truth), flat(corrected.poses[:, :2]), "se2")["rmse"], rel=1e-9)
    assert after < before / 2, (before, after)


def test_a_point_stays_in_the_image_and_moves_on_the_floor(run):
    softness = Softness(FLOOR, rootsift_look(FLOOR.metres_per_px))
    points = choose_points(Parameters(NONE, words(256)), run, softness)
    moved = remounted(run.camera, WRONG)
    rays = apply(jnp.linalg.inv(image_from_floor(moved)), points.keypoints)
    view = image_from_view(moved, FLOOR)
    on_floor = apply(FLOOR.floor_from_view, apply(adjugate(view), points.keypoints))
    np.testing.assert_allclose(on_floor, rays, atol=1e-9)
    used = np.asarray(points.mask) > 0
    assert 0.3 < used.mean() < 1
    inside = np.asarray(points.keypoints)[used]
    assert (inside > 0).all() and (inside < [159, 119]).all()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_a_point_stays_in_the_raw_image_when_the_lens_changes(model):
    run = driven(model)
    softness, none = Softness(FLOOR, patches, points=40), unchanged(run.camera)
    at = Parameters(NONE, jax.tree.map(lambda leaf: leaf.astype(jnp.float32), words(9)), None, none)
    run = replace(run, images=run.images[:1].astype(jnp.float32))
    points = choose_points(at, run, softness)
    bent = replace(none, coefficients=0.2 * jnp.asarray(run.camera.lens.coefficients), intrinsics=jnp.ones(4))
    camera = with_optics(run.camera, bent)
    _, on_floor, mask = describe(replace(at, optics=bent), run, points, softness)
    used = np.asarray(mask) > 0
    assert used.mean() > 0.3
    back = raw_from_ideal(camera, apply(image_from_floor(camera), on_floor))
    np.testing.assert_allclose(back[used], points.keypoints[used], atol=1e-9)
    _, before, _ = describe(at, run, points, softness)
    assert np.abs(on_floor - before)[used].max() > 0.002


@pytest.mark.parametrize("name", ["rootsift", "network"])
def test_a_look_knows_the_view_turned_by_pi(name):
    rng = np.random.default_rng(2)
    view, seen = jnp.asarray(rng.uniform(size=(52, 52, 1))), jnp.asarray(rng.uniform(size=(52, 52)) > 0.02, float)
    points = jnp.asarray(rng.uniform(8, 44, (20, 2)))
    graph, state = nnx.split(Small(nnx.Rngs(0)))
    look = rootsift_look(0.02) if name == "rootsift" else network_look(graph)
    look = jax.jit(partial(look, None if name == "rootsift" else state))
    straight, turned = look(view, seen, points)
    other_straight, other_turned = look(view[::-1, ::-1], seen[::-1, ::-1], 51 - points)
    np.testing.assert_allclose(other_straight, turned, atol=1e-6)
    np.testing.assert_allclose(other_turned, straight, atol=1e-6)
    np.testing.assert_allclose(jnp.linalg.norm(straight, axis=-1), 1, atol=1e-6)
