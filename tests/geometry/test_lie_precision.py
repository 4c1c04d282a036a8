"""The logs and their derivatives against arithmetic with fifty digits, from angle 0 to pi."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

from ebjax.geometry.lie import GROUPS

ANGLES = (0.0, 1e-12, 1e-8, 3e-5, 1e-3, 0.1, 1.0, 2.5, np.pi - 1e-6)
mp.mp.dps = 50


def tangents(group):
    rng, d = np.random.default_rng(0), GROUPS[group].dim
    out = rng.normal(size=(len(ANGLES), d))
    axis = rng.normal(size=(len(ANGLES), d - (d + 1) // 2)) if group == "se3" else np.ones((len(ANGLES), 1))
    out[:, (2 if group == "se2" else 3) :] = axis / np.linalg.norm(axis, axis=1)[:, None] * np.array(ANGLES)[:, None]
    return out


def hat(group, t):
    if group == "se2":
        x, y, w = t
        return mp.matrix([[0, -w, x], [w, 0, y], [0, 0, 0]])
    x, y, z, a, b, c = t
    return mp.matrix([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]])


def small_adjoint(group, t):
    """ad with [t, u] = ad u, from the structure constants."""
    bracket = GROUPS[group].bracket
    d = len(t)
    return mp.matrix([[mp.fsum(t[i] * int(bracket[i, j, k]) for i in range(d)) for j in range(d)] for k in range(d)])


def inverse_right_jacobian(group, t):
    """(sum_n (-ad)^n / (n + 1)!)^-1."""
    ad = small_adjoint(group, t)
    power, total = mp.eye(len(t)), mp.zeros(len(t))
    for n in range(70):
        total += power / mp.factorial(n + 1)
        power = -power * ad
    return total**-1


def to_float(matrix):
    return np.array(matrix.tolist(), dtype=object).astype(float)


def matrix_of(group, pose):
    """The homogeneous matrix of a float64 pose, its quaternion made unit, in high precision."""
    p = [mp.mpf(float(v)) for v in pose]
    if group == "se2":
        c, s = mp.cos(p[2]), mp.sin(p[2])
        return mp.matrix([[c, -s, p[0]], [s, c, p[1]], [0, 0, 1]])
    n = mp.sqrt(mp.fsum(v * v for v in p[:4]))
    w, x, y, z = (v / n for v in p[:4])
    return mp.matrix(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), p[4]],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), p[5]],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), p[6]],
            [0, 0, 0, 1],
        ]
    )


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_values_to_1e_12(group):
    lie = GROUPS[group]
    poses = jax.jit(lie.exp)(jnp.asarray(tangents(group)))
    for pose, log in zip(np.asarray(poses), np.asarray(jax.jit(lie.log)(poses)), strict=True):
        again = mp.expm(hat(group, [mp.mpf(float(v)) for v in log]))
        np.testing.assert_allclose(to_float(again - matrix_of(group, pose)), 0, atol=1e-12)


@pytest.mark.parametrize("group", ["se2", "se3"])
def test_jacobians_to_1e_9(group):
    lie, at = GROUPS[group], jnp.asarray(tangents(group))
    exact = np.stack([to_float(inverse_right_jacobian(group, [mp.mpf(float(v)) for v in t])) for t in at])
    np.testing.assert_allclose(jax.jit(lie.log_jacobian)(at), exact, atol=1e-9)

    def moved(tangent, delta):
        return lie.log(lie.compose(lie.exp(tangent), lie.exp(delta)))

    automatic = jax.jit(jax.vmap(jax.jacfwd(moved, argnums=1)))(at, jnp.zeros_like(at))
    np.testing.assert_allclose(automatic, exact, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("group", ["se2", "se3"])
def test_second_derivatives_to_1e_6(group):
    lie, at = GROUPS[group], tangents(group)
    automatic = jax.jit(jax.vmap(jax.jacfwd(lie.log_jacobian)))(jnp.asarray(at))
    h = mp.mpf(10) ** -18
    for t, slopes in zip(at, np.asarray(automatic), strict=True):
        for k in range(lie.dim):
            here = [mp.mpf(float(v)) for v in t]
            up, down = ([v + s * h * (k == i) for i, v in enumerate(here)] for s in (1, -1))
            exact = (inverse_right_jacobian(group, up) - inverse_right_jacobian(group, down)) / (2 * h)
            np.testing.assert_allclose(slopes[:, :, k], to_float(exact), atol=1e-6)
