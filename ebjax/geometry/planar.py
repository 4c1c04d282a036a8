"""Planar poses (x m, y m, heading rad) on the host: NumPy, rows of poses."""

import numpy as np
from jaxtyping import Float

Poses = Float[np.ndarray, "*n 3"]


def wrapped(angle: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """The angle in [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def compose(a_from_b: Poses, b_from_c: Poses) -> Poses:
    """a_from_c; the heading is not wrapped."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = b_from_c[..., 0], b_from_c[..., 1]
    moved = [a_from_b[..., 0] + c * x - s * y, a_from_b[..., 1] + s * x + c * y]
    return np.stack([*moved, a_from_b[..., 2] + b_from_c[..., 2]], -1)


def inverse(a_from_b: Poses) -> Poses:
    """b_from_a."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = a_from_b[..., 0], a_from_b[..., 1]
    return np.stack([-c * x - s * y, s * x - c * y, -a_from_b[..., 2]], -1)


def between(world_from_a: Poses, world_from_b: Poses) -> Poses:
    """a_from_b, the heading wrapped."""
    relative = compose(inverse(world_from_a), world_from_b)
    relative[..., 2] = wrapped(relative[..., 2])
    return relative


def matrix(a_from_b: Poses) -> Float[np.ndarray, "*n 3 3"]:
    """Of poses, for homogeneous points."""
    c, s = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [[c, -s, a_from_b[..., 0]], [s, c, a_from_b[..., 1]], [zero, zero, one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def chained(steps: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "N 3"]:
    """The path (0, 0, 0), steps[0], steps[0] steps[1], ...; the heading goes on beyond pi."""
    heading = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x, y = c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]
    return np.stack([np.concatenate([[0.0], np.cumsum(x)]), np.concatenate([[0.0], np.cumsum(y)]), heading], 1)


def adjoint(a_from_b: Poses) -> Float[np.ndarray, "*n 3 3"]:
    """Ad with pose exp(d) = exp(Ad d) pose."""
    c, s, x, y = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2]), a_from_b[..., 0], a_from_b[..., 1]
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [[c, -s, y], [s, c, -x], [zero, zero, one]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def inverse_covariance(a_from_b: Poses, covariance: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """The covariance of b_from_a in its right tangent, from that of a_from_b."""
    ad = adjoint(a_from_b)
    return ad @ covariance @ np.swapaxes(ad, -1, -2)


def log(pose: Poses) -> Poses:
    """The tangent (v, theta) with exp(v, theta) = pose."""
    theta = wrapped(pose[..., 2])
    half = theta / 2
    c = np.where(np.abs(half) < 1e-4, 1 - half**2 / 3, half / np.tan(np.where(half == 0, 1.0, half)))
    x, y = pose[..., 0], pose[..., 1]
    return np.stack([c * x + half * y, c * y - half * x, theta], -1)


def log_jacobian(tangent: Poses) -> Float[np.ndarray, "*n 3 3"]:
    """The derivative of log(exp(tangent) exp(d)) at d = 0: I + ad / 2 + K ad^2."""
    x, y, theta = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    half, small = theta / 2, np.abs(theta) < 1e-2
    c = np.where(small, 1 - half**2 / 3 - half**4 / 45, half / np.tan(np.where(small, 1.0, half)))
    k = np.where(small, 1 / 12 + theta**2 / 720, (1 - c) / np.where(small, 1.0, theta**2))
    zero, one = np.zeros_like(theta), np.ones_like(theta)
    rows = [[c, -half, y / 2 + k * theta * x], [half, c, k * theta * y - x / 2], [zero, zero, one]]
    return np.stack([np.stack(row, -1) for row in rows], -2)
