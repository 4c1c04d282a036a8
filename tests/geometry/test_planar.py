import jax
import jaxlie
import numpy as np
import pytest

from ebjax.geometry import planar, se2

ANGLES = [0.0, 1e-12, -1e-7, 1.9e-4, -2.1e-4, 0.02, -0.7, 1.5, 3.0, -3.14, 7.0, -20.0]


def poses(seed=0, angles=ANGLES):
    random = np.random.default_rng(seed)
    turns = np.repeat(angles, 3)
    random.shuffle(turns)
    return np.stack([*random.normal(scale=3, size=(2, len(turns))), turns], 1)


matrices = jax.jit(lambda rows: jaxlie.SE2.from_xy_theta(*rows.T).as_matrix())
logarithms = jax.jit(lambda rows: jaxlie.SE2.from_xy_theta(*rows.T).log())
compose, inverse, adjoint, exp, log, log_jacobian = map(
    jax.jit, (se2.compose, se2.inverse, se2.adjoint, se2.exp, se2.log, se2.log_jacobian)
)


def same(found, expected, atol=1e-12):
    """Poses with headings that are equal up to whole turns."""
    found, expected = np.asarray(found), np.asarray(expected)
    np.testing.assert_allclose(found[..., :2], expected[..., :2], atol=atol)
    np.testing.assert_allclose(planar.wrapped(found[..., 2] - expected[..., 2]), 0, atol=atol)


def random_covariances(count, seed=5):
    root = np.random.default_rng(seed).normal(size=(count, 3, 3)) * np.array([0.02, 0.01, 0.005])[None, :, None]
    return root @ root.swapaxes(1, 2)


def test_compose_and_inverse_are_those_of_the_group():
    a, b = poses(0), poses(1)
    same(planar.compose(a, b), compose(a, b))
    same(planar.inverse(a), inverse(a))
    np.testing.assert_allclose(matrices(planar.compose(a, b)), matrices(a) @ matrices(b), atol=1e-12)
    np.testing.assert_allclose(matrices(planar.inverse(a)), np.linalg.inv(matrices(a)), atol=1e-12)
    np.testing.assert_array_equal(planar.compose(a, b)[:, 2], a[:, 2] + b[:, 2])


def test_between_is_what_leads_from_one_to_the_other():
    a, b = poses(0), poses(1)
    found = planar.between(a, b)
    same(planar.compose(a, found), b)
    same(found, compose(inverse(a), b))
    assert ((found[:, 2] >= -np.pi) & (found[:, 2] < np.pi)).all()


@pytest.mark.parametrize("angle", [0.0, np.pi, -np.pi, 3 * np.pi, 2 * np.pi, 1e3, -1e3])
def test_wrapped_is_the_same_angle_within_half_a_turn(angle):
    found = planar.wrapped(np.array([angle]))
    assert -np.pi <= found[0] < np.pi
    np.testing.assert_allclose([np.cos(found), np.sin(found)], [[np.cos(angle)], [np.sin(angle)]], atol=1e-12)


def test_log_is_that_of_the_group_at_every_angle():
    pose = poses(2)
    found = planar.log(pose)
    np.testing.assert_allclose(found, log(pose), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found, logarithms(pose), rtol=1e-7, atol=1e-7)
    same(exp(found), pose)


def test_adjoint_moves_a_tangent_through_the_pose():
    pose, tangent = poses(3), 0.3 * poses(4, np.linspace(-1, 1, len(ANGLES)))
    found = planar.adjoint(pose)
    np.testing.assert_allclose(found, adjoint(pose), atol=1e-12)
    moved = np.einsum("nab,nb->na", found, tangent)
    left = compose(exp(moved), pose)
    same(planar.compose(pose, np.asarray(exp(tangent))), left, atol=1e-10)


def test_log_jacobian_is_the_derivative_of_the_log():
    tangent = poses(12, [0.0, 1e-9, -1e-4, 0.0099, -0.0101, 0.3, -1.5, 3.0, -3.14])
    found = planar.log_jacobian(tangent)
    np.testing.assert_allclose(found, log_jacobian(tangent), rtol=1e-10, atol=1e-10)
    start, step = np.asarray(exp(tangent)), 1e-6
    for k, e in enumerate(np.tile(np.eye(3)[:, None], (1, len(tangent), 1))):
        above, below = (planar.log(planar.compose(start, sign * step * e)) for sign in (1, -1))
        good = np.abs(tangent[:, 2]) < 3.1
        np.testing.assert_allclose(found[good, :, k], ((above - below) / (2 * step))[good], atol=1e-8)


def test_chained_is_one_composition_after_the_other():
    steps = np.random.default_rng(6).normal(scale=[1.0, 0.3, 1.5], size=(40, 3))
    path = [np.zeros(3)]
    for step in steps:
        path.append(planar.compose(path[-1], step))
    np.testing.assert_allclose(planar.chained(steps), path, atol=1e-12)
    assert np.abs(path[-1][2]) > np.pi, "the heading is to go beyond half a turn here"
    np.testing.assert_array_equal(planar.chained(np.zeros((0, 3))), np.zeros((1, 3)))


def test_chained_undoes_between():
    path = np.cumsum(np.random.default_rng(7).normal(scale=[0.3, 0.1, 0.4], size=(30, 3)), 0)
    again = planar.chained(planar.between(path[:-1], path[1:]))
    same(planar.between(np.tile(path[:1], (30, 1)), path), again)


def test_covariance_of_the_inverse_is_what_monte_carlo_finds():
    pose = np.array([1.5, -0.8, 2.2])
    covariance = random_covariances(1)[0]
    noise = np.random.default_rng(8).multivariate_normal(np.zeros(3), covariance, 20000)
    many = np.tile(pose, (20000, 1))
    noisy = planar.compose(many, np.asarray(exp(noise)))
    off = planar.log(planar.between(planar.inverse(many), planar.inverse(noisy)))
    predicted = planar.inverse_covariance(pose, covariance)
    sigma = np.sqrt(np.diag(predicted))
    np.testing.assert_allclose(np.cov(off.T) / np.outer(sigma, sigma), predicted / np.outer(sigma, sigma), atol=0.04)


def test_covariance_of_the_inverse_of_the_inverse_is_the_first_again():
    pose, covariance = poses(9), random_covariances(3 * len(ANGLES))
    turned = planar.inverse_covariance(pose, covariance)
    back = planar.inverse_covariance(planar.inverse(pose), turned)
    np.testing.assert_allclose(back, covariance, rtol=1e-9, atol=1e-14)
    # The error's length in standard deviations is the same seen from either end.
    d = np.random.default_rng(10).normal(scale=1e-8, size=pose.shape)
    off = planar.log(planar.between(planar.inverse(pose), planar.inverse(planar.compose(pose, d))))
    here = np.einsum("na,nab,nb->n", d, np.linalg.inv(covariance), d)
    there = np.einsum("na,nab,nb->n", off, np.linalg.inv(turned), off)
    np.testing.assert_allclose(there, here, rtol=1e-4)


def test_matrices_are_those_of_jaxlie():
    pose = poses(12)
    expected = np.stack([np.asarray(jaxlie.SE2.from_xy_theta(*one).as_matrix()) for one in pose])
    np.testing.assert_allclose(planar.matrix(pose), expected, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
def test_any_leading_axes(shape):
    random = np.random.default_rng(11)
    a, b = random.normal(size=(2, *shape, 3))
    for found in (planar.compose(a, b), planar.inverse(a), planar.between(a, b), planar.log(a)):
        assert found.shape == (*shape, 3)
    assert planar.log_jacobian(a).shape == planar.matrix(a).shape == (*shape, 3, 3)
    assert planar.adjoint(a).shape == planar.inverse_covariance(a, np.zeros((*shape, 3, 3))).shape == (*shape, 3, 3)
