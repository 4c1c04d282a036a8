import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
import scipy.linalg

from ebjax.geometry import lie, se2

GROUPS = {
    name: group._replace(**{part: jax.jit(call) for part, call in group._asdict().items() if callable(call)})
    for name, group in lie.GROUPS.items()
}
ANGLES = [0.0, 1e-12, 1e-9, 3e-5, 1e-3, 0.1, 0.99, 1.01, 2.0, 3.0, np.pi - 1e-6]


def tangents(group, angles=ANGLES, each=3):
    angles = np.repeat(angles, each)
    xi = np.random.default_rng(0).normal(size=(len(angles), GROUPS[group].dim))
    spin = xi[:, 2:] if group == "se2" else xi[:, 3:]
    spin *= angles[:, None] / np.linalg.norm(spin, axis=1, keepdims=True)
    return jnp.asarray(xi)


def matrix(group, pose):
    if group == "se2":
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])
    return np.asarray(jaxlie.SE3(pose).as_matrix())


def generator(group, xi):
    if group == "se2":
        return np.array([[0, -xi[2], xi[0]], [xi[2], 0, xi[1]], [0, 0, 0]])
    out = np.zeros((4, 4))
    out[:3, :3] = np.cross(np.eye(3), np.asarray(xi[3:]))
    out[:3, 3] = xi[:3]
    return out


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_exp_is_the_matrix_exponential_and_log_inverts_it(group):
    xi = tangents(group)
    pose = GROUPS[group].exp(xi)
    for row, tangent in zip(pose, xi, strict=True):
        np.testing.assert_allclose(matrix(group, row), scipy.linalg.expm(generator(group, tangent)), atol=2e-14)
    np.testing.assert_allclose(GROUPS[group].log(pose), xi, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_log_jacobian_is_the_derivative_of_the_log(group):
    g, xi = GROUPS[group], tangents(group)
    for derivative in (jax.jacfwd, jax.jacrev):
        through = derivative(lambda d, x: g.log(g.compose(g.exp(x), g.exp(d))))
        jacobian = jax.jit(jax.vmap(through))(jnp.zeros_like(xi), xi)
        np.testing.assert_allclose(jacobian, g.log_jacobian(xi), atol=1e-12)


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_the_turn_of_the_log_jacobian_is_its_derivative(group):
    g, xi = GROUPS[group], tangents(group)
    covector = jnp.asarray(np.random.default_rng(1).normal(size=xi.shape))
    turn = jax.jit(jax.vmap(jax.jacfwd(lambda x, c: g.log_jacobian(x).T @ c)))(xi, covector)
    np.testing.assert_allclose(g.log_jacobian_turn(xi, covector), turn, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_second_derivatives_hold_at_every_angle(group):
    g, xi = GROUPS[group], tangents(group, [t for t in ANGLES if t < 3.1], 1)
    through = lambda d, x: g.log(g.compose(g.exp(x), g.exp(d)))  # noqa: E731
    zero, h = jnp.zeros_like(xi), 1e-5
    hessian = jax.jit(jax.vmap(jax.jacfwd(jax.jacrev(through))))(zero, xi)
    slope = jax.jit(jax.vmap(jax.jacfwd(through)))
    for k in range(g.dim):
        step = zero.at[:, k].set(h)
        np.testing.assert_allclose(hessian[..., k], (slope(step, xi) - slope(-step, xi)) / (2 * h), atol=2e-9)


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_left_tangent_is_the_change_of_the_pose(group):
    g, rng = GROUPS[group], np.random.default_rng(3)
    pose = g.exp(jnp.asarray(rng.normal(size=(20, g.dim))))
    tangent = jnp.asarray(rng.normal(size=(20, g.dim)))
    _, change = jax.jvp(lambda t: g.compose(g.exp(t * tangent), pose), (0.0,), (1.0,))
    np.testing.assert_allclose(g.left_tangent(pose, change), tangent, atol=1e-12)
    if group == "se3":
        longer = change + pose * jnp.array([1.0, 1, 1, 1, 0, 0, 0])[None]
        np.testing.assert_allclose(g.left_tangent(pose, longer), tangent, atol=1e-12)


def test_se2_log_has_its_known_second_derivatives_at_zero():
    hessian = jax.jit(jax.hessian(se2.log))(jnp.array([0.7, -0.4, 0.0]))
    assert hessian[0, 2, 2] == pytest.approx(-0.7 / 6, abs=1e-14)  # the cotangent's first term, theta^2 / 12
    assert hessian[0, 1, 2] == pytest.approx(0.5, abs=1e-14)


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_group_axioms_and_adjoint(group):
    g = GROUPS[group]
    a, b, c = (g.exp(tangents(group, [t])) for t in (0.3, 1.7, 2.9))
    identity = jnp.broadcast_to(jnp.asarray(g.identity), a.shape)
    close = lambda x, y: np.testing.assert_allclose(g.log(g.compose(g.inverse(x), y)), 0, atol=1e-12)  # noqa: E731
    close(g.compose(a, g.compose(b, c)), g.compose(g.compose(a, b), c))
    close(g.compose(g.inverse(a), a), identity)
    d = tangents(group, [0.2])
    carried = jnp.einsum("nij,nj->ni", g.adjoint(a), d)
    close(g.compose(a, g.exp(d)), g.compose(g.exp(carried), a))


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_bracket_is_the_commutator_of_generators(group):
    g = GROUPS[group]
    basis = np.array([generator(group, e) for e in np.eye(g.dim)])
    for k in range(g.dim):
        for m in range(g.dim):
            commutator = basis[k] @ basis[m] - basis[m] @ basis[k]
            np.testing.assert_allclose(np.tensordot(g.bracket[k, m], basis, 1), commutator, atol=1e-15)


def test_se3_agrees_with_jaxlie():
    a, b = GROUPS["se3"].exp(tangents("se3", [0.4])), GROUPS["se3"].exp(tangents("se3", [1.1]))
    for x, y, mine in zip(a, b, GROUPS["se3"].compose(a, b), strict=True):
        np.testing.assert_allclose((jaxlie.SE3(x) @ jaxlie.SE3(y)).wxyz_xyz, mine, atol=1e-14)


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_float32_stays_float32_and_accurate(group):
    g, xi = GROUPS[group], tangents(group, [t for t in ANGLES if t < 3.1])
    small = xi.astype(jnp.float32)
    for function in (g.exp, g.log_jacobian, jax.jit(lambda x: g.log(g.exp(x)))):
        out = function(small)
        assert out.dtype == jnp.float32
        np.testing.assert_allclose(out, function(small.astype(jnp.float64)), atol=2e-5)


def test_a_quaternion_and_its_negative_have_one_log():
    pose = GROUPS["se3"].exp(tangents("se3", [2.5]))
    np.testing.assert_allclose(GROUPS["se3"].log(pose.at[:, :4].multiply(-1)), GROUPS["se3"].log(pose), atol=1e-14)
