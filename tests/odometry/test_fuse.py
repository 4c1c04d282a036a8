from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.evaluation.nees import nees, tangent_errors
from ebjax.evaluation.trajectory import ate
from ebjax.geometry.planar import adjoint, between, chained, compose, inverse
from ebjax.odometry.fuse import CONTRADICTED, fuse
from ebjax.odometry.steps import USED, Steps, judged
from ebjax.odometry.wheels import Systematic, WheelErrors
from ebjax.posegraph import analyse, make_graph, solve

COUNT = 60
ROWS = np.arange(COUNT - 1)
SECONDS = 0.4 + 0.15 * np.sin(ROWS)
TIMES = np.concatenate([[3.0], 3.0 + np.cumsum(SECONDS)])
# Once round in a circle, at a speed that changes slowly.
LENGTHS = SECONDS * (0.5 + 0.1 * np.sin(ROWS / 10))
TRUTH = chained(np.stack([LENGTHS, np.zeros(COUNT - 1), 2 * np.pi * LENGTHS / LENGTHS.sum()], 1))
TRUE_STEPS = between(TRUTH[:-1], TRUTH[1:])
VIEW_CENTRE = np.array([1.9, 0.0, 0.0])
SIGMA = np.array([0.0015, 0.25 * 1.9 * np.radians(0.05), np.radians(0.05)])
ERRORS = WheelErrors()


def perturbed(poses, tangents):
    """poses * exp(tangents)."""
    x, y, turn = np.moveaxis(tangents, -1, 0)
    a, b = np.sinc(turn / np.pi), np.sin(turn / 2) * np.sinc(turn / (2 * np.pi))
    return compose(poses, np.stack([a * x - b * y, b * x + a * y, turn], -1))


def floor_steps(random, gaps=(1, 2, 4)):
    """Steps of which each view has its own error, at its centre."""
    earlier = np.concatenate([np.arange(COUNT - gap) for gap in gaps])
    later = earlier + np.repeat(gaps, [COUNT - gap for gap in gaps])
    to_base = adjoint(VIEW_CENTRE)
    views = perturbed(TRUTH, (SIGMA / np.sqrt(2) * random.standard_normal((COUNT, 3))) @ to_base.T)
    covariance = np.tile(to_base @ np.diag(SIGMA**2) @ to_base.T, (len(later), 1, 1))
    many = np.full(len(later), 60)
    kind = np.full(len(later), "floor", object)
    return judged(later, earlier, kind, many, many, between(views[later], views[earlier]), covariance)


def wheel_path(random, steps=TRUE_STEPS, noise=1.0):
    sigma = noise * ERRORS.step_sigmas(chained(steps))
    return chained(perturbed(steps, sigma * random.standard_normal(sigma.shape)))


def without(steps, *keyframes):
    return steps.refuse(np.isin(steps.i, keyframes) | np.isin(steps.j, keyframes), "few matches")


def fused(steps, wheels=None, wrong=None):
    wrong = Systematic() if wheels is not None and wrong is None else wrong
    return fuse(steps, COUNT, TIMES, wheels, wrong, ERRORS)


def error_m(poses):
    truth, found = (np.concatenate([p[:, :2], np.zeros((COUNT, 1))], 1) for p in (TRUTH, poses))
    return ate(truth, found, "se2")["rmse"]


def lowest(matrices):
    return np.linalg.eigvalsh(matrices)[:, 0]


@pytest.mark.parametrize("with_wheels", [True, False])
def test_poses_are_near_the_truth_and_the_chain_has_one_edge_a_step(with_wheels):
    random = np.random.default_rng(0)
    steps, wheels = floor_steps(random), wheel_path(random)
    found = fused(steps, wheels if with_wheels else None)
    assert error_m(found.poses) < 0.01 < error_m(wheels) / 2
    np.testing.assert_array_equal(found.chain.i, ROWS)
    np.testing.assert_array_equal(found.chain.j, ROWS + 1)
    off = tangent_errors(found.chain.measured, TRUE_STEPS)
    assert (np.sqrt(np.mean(off**2, 0)) < [0.003, 0.003, np.radians(0.1)]).all()
    assert found.jumps == [] and found.carried == 0
    assert list(found.steps.reason) == [USED] * len(steps.i)
    far = steps.i - steps.j > 1
    np.testing.assert_array_equal(found.further.i, steps.i[far])
    np.testing.assert_array_equal(found.further.j, steps.j[far])
    np.testing.assert_array_equal(found.further.measured, steps.i_from_j[far])
    for matrices in (found.covariance, found.chain.information, found.further.information):
        assert (lowest(matrices) > 0).all()
        np.testing.assert_allclose(matrices, matrices.swapaxes(1, 2), rtol=1e-9, atol=1e-7 * np.abs(matrices).max())


def test_the_chain_knows_at_least_what_the_wheels_and_the_step_know():
    random = np.random.default_rng(1)
    steps, wheels = floor_steps(random, (1,)), wheel_path(random)
    found = fused(steps, wheels)
    of_wheels = np.einsum("na,ab->nab", ERRORS.step_sigmas(wheels) ** -2.0, np.eye(3))
    assert (lowest(found.chain.information - of_wheels) > 0).all()
    turned = adjoint(inverse(steps.i_from_j))
    of_floor = turned.swapaxes(1, 2) @ np.linalg.inv(steps.covariance) @ turned
    weak = lowest(found.chain.information - of_wheels - of_floor)
    np.testing.assert_allclose(weak / np.linalg.norm(of_floor, axis=(1, 2)), 0, atol=1e-6)
    assert (np.trace(found.covariance, axis1=1, axis2=2) < np.trace(np.linalg.inv(of_wheels), axis1=1, axis2=2)).all()


@pytest.mark.slow
@pytest.mark.parametrize("gaps", [(1,), (1, 2), (1, 2, 4)])
@pytest.mark.parametrize("with_wheels", [True, False])
def test_covariance_of_the_steps_is_as_large_as_their_errors(gaps, with_wheels):
    values, chain = [], []
    for seed in range(6):
        random = np.random.default_rng(seed)
        steps, wheels = floor_steps(random, gaps), wheel_path(random)
        found = fused(steps, wheels if with_wheels else None)
        off = tangent_errors(between(found.poses[:-1], found.poses[1:]), TRUE_STEPS)
        values.append(nees(off, found.covariance).mean())
        chain.append(nees(tangent_errors(found.chain.measured, TRUE_STEPS), np.linalg.inv(found.chain.information)))
    assert 1 < np.mean(values) < 5
    assert 1 < np.mean(chain) < 5


def test_wheels_carry_a_keyframe_without_any_step():
    random = np.random.default_rng(2)
    steps, wheels = without(floor_steps(random), 30), wheel_path(random)
    found = fused(steps, wheels)
    assert found.carried == 0 and found.jumps == []
    of_wheels = ERRORS.step_sigmas(wheels) ** -2.0
    for row in (29, 30):
        np.testing.assert_allclose(found.chain.information[row], np.diag(of_wheels[row]), rtol=1e-3)
        np.testing.assert_allclose(found.chain.measured[row], between(wheels[row], wheels[row + 1]), atol=1e-3)
    assert error_m(found.poses) < 0.01
    # The keyframes around it are measured against each other.
    off = tangent_errors(between(found.poses[29:30], found.poses[31:32]), between(TRUTH[29:30], TRUTH[31:32]))
    assert np.hypot(*off[0, :2]) < 0.01


@pytest.mark.parametrize("missing", [(30,), (30, 31, 32), (0,), (59,)])
def test_without_wheels_what_nothing_measured_goes_on_at_the_speed_around_it(missing):
    random = np.random.default_rng(3)
    steps = without(floor_steps(random, (1,)), *missing)
    found = fused(steps)
    open_rows = np.isin(ROWS, missing) | np.isin(ROWS + 1, missing)
    assert found.carried == open_rows.sum()
    np.testing.assert_array_equal(found.chain.i, ROWS)
    np.testing.assert_array_equal(found.chain.j, ROWS + 1)
    assert np.isfinite(found.poses).all() and (lowest(found.chain.information) > 0).all()
    off = tangent_errors(between(found.poses[:-1], found.poses[1:]), TRUE_STEPS)[open_rows]
    assert (np.abs(off) < [0.015, 0.006, np.radians(1.5)]).all()
    np.testing.assert_allclose(found.chain.measured[open_rows], between(found.poses[:-1], found.poses[1:])[open_rows])
    sigma = np.sqrt(found.covariance[open_rows][:, [0, 1, 2], [0, 1, 2]])
    assert (sigma > [1.0, 1.0, 0.6]).all(), "hardly believed"
    assert error_m(found.poses) < 0.05


def test_what_longer_steps_span_is_not_carried():
    random = np.random.default_rng(4)
    steps = floor_steps(random)
    alone = (steps.j == 30) & (steps.i == 31)
    found = fused(steps.refuse(alone, "few matches"))
    assert found.carried == 0
    off = tangent_errors(between(found.poses[30:31], found.poses[31:32]), TRUE_STEPS[30:31])
    assert np.hypot(*off[0, :2]) < 0.01
    assert np.sqrt(found.covariance[30, 0, 0]) < 0.02


@pytest.mark.parametrize("jump", [[8.0, 0.0, 0.0], [-3.0, 4.0, 2.0]])
@pytest.mark.parametrize("row", [0, 25, 58])
def test_a_jump_of_the_odometry_is_named(row, jump):
    random = np.random.default_rng(5)
    steps, wheels = floor_steps(random), wheel_path(random)
    counted = between(wheels[:-1], wheels[1:])
    counted[row] = jump
    found = fused(steps, chained(counted))
    (named,) = found.jumps
    assert named.frame == row + 1
    assert named.metres == pytest.approx(np.hypot(*jump[:2]))
    assert named.degrees == pytest.approx(np.degrees(jump[2]))
    assert named.seconds == pytest.approx(SECONDS[row])
    assert error_m(found.poses) < 0.01 and found.carried == 0
    assert found.steps.used.all()
    off = tangent_errors(found.chain.measured[row : row + 1], TRUE_STEPS[row : row + 1])
    assert np.hypot(*off[0, :2]) < 0.01


def test_steps_that_the_others_contradict_are_refused():
    random = np.random.default_rng(6)
    steps, wheels = floor_steps(random), wheel_path(random)
    wrong = np.zeros(len(steps.i), bool)
    wrong[[7, 8, 40, COUNT + 20, 2 * COUNT + 9]] = True
    measured = steps.i_from_j.copy()
    measured[wrong] = compose(measured[wrong], np.tile([0.3, 0.0, 0.0], (5, 1)))
    refused_before = np.arange(len(wrong)) == 12
    table = replace(steps, i_from_j=measured).refuse(refused_before, "uncertain")
    found = fused(table, wheels)
    assert set(found.steps.reason[wrong]) == {CONTRADICTED}
    assert list(found.steps.reason[refused_before]) == ["uncertain"]
    assert found.steps.used[~wrong & ~refused_before].all()
    assert len(found.further.i) == (steps.i - steps.j > 1).sum() - 2
    assert error_m(found.poses) < 0.01 and found.jumps == []


def test_what_is_wrong_with_all_wheel_steps_is_no_jump():
    random = np.random.default_rng(7)
    steps = floor_steps(random)
    counted = TRUE_STEPS / np.array([1.1, 1.1, 0.8])
    wheels = wheel_path(random, counted, 0.7)
    told = Systematic(scale=1.1, gain=0.8, steps=COUNT - 1)
    found = fused(without(steps, 30, 31), wheels, told)
    assert found.jumps == [] and error_m(found.poses) < 0.02
    off = tangent_errors(found.chain.measured, TRUE_STEPS)
    assert (np.abs(off[29:32]) < [0.03, 0.03, np.radians(5)]).all()


def test_a_rotation_turns_the_wheels_step_and_does_not_move_it():
    random = np.random.default_rng(8)
    steps, wheels = floor_steps(random, (1,)), wheel_path(random)
    some = (steps.j >= 20) & (steps.j < 30)
    measured = steps.i_from_j.copy()
    measured[some, :2] = 0
    table = replace(steps, i_from_j=measured, kind=np.where(some, "rotation", steps.kind))
    found = fused(table, wheels)
    assert found.jumps == [] and found.steps.used.all() and found.carried == 0
    counted = between(wheels[:-1], wheels[1:])
    np.testing.assert_allclose(found.chain.measured[some, :2], counted[some, :2], atol=0.004)
    off = tangent_errors(found.chain.measured, TRUE_STEPS)
    assert np.degrees(np.abs(off[some, 2])).max() < 0.3


def test_wheels_alone():
    wheels = wheel_path(np.random.default_rng(9))
    nothing = floor_steps(np.random.default_rng(9)).refuse(np.ones(3 * COUNT - 7, bool), "few matches")
    found = fused(nothing, wheels)
    np.testing.assert_allclose(between(found.poses[:-1], found.poses[1:]), between(wheels[:-1], wheels[1:]), atol=1e-9)
    np.testing.assert_allclose(found.covariance, ERRORS.step_covariance(wheels), rtol=1e-3)
    assert found.carried == 0 and found.jumps == [] and len(found.further.i) == 0


def test_nothing_at_all():
    empty = np.zeros(0, int)
    none = Steps(empty, empty, empty.astype(object), empty, empty, np.zeros((0, 3)), np.zeros((0, 3, 3)), empty == 0)
    found = fused(none)
    assert found.carried == COUNT - 1
    np.testing.assert_array_equal(found.poses, np.zeros((COUNT, 3)))
    assert (lowest(found.chain.information) > 0).all()


def ate_m(positions):
    """Root mean square distance from the truth after the best turn and shift."""
    truth = jnp.asarray(TRUTH[:, :2])
    p, q = positions - positions.mean(0, keepdims=True), truth - truth.mean(0, keepdims=True)
    turn = jnp.arctan2(jnp.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), jnp.sum(p * q))
    c, s = jnp.cos(turn), jnp.sin(turn)
    return jnp.sqrt(jnp.mean(jnp.sum((p @ jnp.stack([jnp.stack([c, s]), jnp.stack([-s, c])]) - q) ** 2, 1)))


@pytest.mark.slow
def test_gradient_of_the_trajectory_error_in_a_step():
    random = np.random.default_rng(10)
    found = fused(floor_steps(random, (1, 2)), wheel_path(random))
    i, j = np.array([57, 58, 59]), np.array([0, 1, 2])
    loops = perturbed(between(TRUTH[i], TRUTH[j]), random.normal(scale=[0.01, 0.01, 0.005], size=(3, 3)))
    edges = (found.chain, found.further)
    information = [*(e.information for e in edges), np.tile(np.diag([1e4, 1e4, 4e4]), (3, 1, 1))]
    graph = make_graph(
        found.poses,
        np.concatenate([*(e.i for e in edges), i]),
        np.concatenate([*(e.j for e in edges), j]),
        np.concatenate([*(e.measured for e in edges), loops]),
        np.concatenate(information),
    )
    structure = analyse(graph, "qdldl")

    @jax.jit
    @jax.value_and_grad
    def error(measured):
        options = {"kernel": "none", "rtol": 1e-20, "structure": structure}
        return ate_m(solve(replace(graph, measured=measured), **options).poses[:, :2])

    at, step = jnp.asarray(graph.measured), 1e-6
    value, slope = error(at)
    assert 0.001 < float(value) < 0.01
    assert float(ate_m(jnp.asarray(found.poses[:, :2]))) == pytest.approx(error_m(found.poses), rel=1e-9)
    directions = [np.zeros_like(slope) for _ in range(4)]
    for k in range(3):
        directions[k][20, k] = 1  # of the chain
    directions[3][:] = random.standard_normal(slope.shape) * [1, 1, 0.1]
    for direction in map(jnp.asarray, directions):
        numeric = float(error(at + step * direction)[0] - error(at - step * direction)[0]) / (2 * step)
        assert abs(numeric) > 1e-4
        assert float(jnp.sum(slope * direction)) == pytest.approx(numeric, rel=1e-5)
