"""What one edge contributes: residual r = log(measured^-1 * i_from_j), cost rho(r^T information r), gradient, Hessian.

With A = world_from_i, B = world_from_j and perturbations on the right, dr/dB = J and dr/dA = -J Ad(j_from_i), so
everything follows from one d x d product per edge. J is Jr^-1(r); of an edge that measures a position only, where
r = (t, 0), t the translation of i_from_j less what was measured, J is [R, 0; 0, 0], R the rotation of i_from_j.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ebjax.geometry import se3
from ebjax.geometry.lie import GROUPS, Group
from ebjax.geometry.small_angle import small_matmul, stack_rows
from ebjax.posegraph.graph import PoseGraph
from ebjax.posegraph.robust import Kernel, Width, rho, weight


class EdgeBlocks(NamedTuple):
    """Gauss-Newton blocks of every edge: Hessian [ii, ij; ij^T, jj] and gradient (gi, gj) of half the cost."""

    ii: Float[Array, "E d d"]
    ij: Float[Array, "E d d"]
    jj: Float[Array, "E d d"]
    gi: Float[Array, "E d"]
    gj: Float[Array, "E d"]


_once = jax.lax.optimization_barrier  # fusion would compute sines and products again for each of their readers


def edge_residual(
    group: str,
    a: Float[Array, "*b P"],
    b: Float[Array, "*b P"],
    measured: Float[Array, "*b P"],
    position: Bool[Array | np.ndarray, "*b"] | None = None,
) -> Float[Array, "*b d"]:
    """log(measured^-1 * a^-1 * b), or where `position` how far b lies from where a sees it, then zeros."""
    lie = GROUPS[group]
    return _residual(lie, lie.compose(lie.inverse(a), b), measured, position)


def _residual(lie: Group, i_from_j, measured, position):
    if position is None:
        return lie.log(lie.compose(lie.inverse(measured), i_from_j))
    at = jnp.asarray(position)[..., None]
    off = jnp.where(at, _translation(i_from_j) - _translation(measured), 0)
    # Against itself the logarithm is smooth where nobody reads it.
    r = lie.log(lie.compose(lie.inverse(jnp.where(at, i_from_j, measured)), i_from_j))
    return jnp.where(at, _padded(off, lie.dim), r)


def _translation(pose):
    return pose[..., :2] if pose.shape[-1] == 3 else pose[..., 4:]


def _padded(vector, size):
    return jnp.concatenate([vector, jnp.zeros_like(vector, shape=(*vector.shape[:-1], size - vector.shape[-1]))], -1)


def _corner(matrix, size):
    """The matrix as the first block of one of `size`, zeros elsewhere."""
    room = size - matrix.shape[-1]
    return jnp.pad(matrix, [(0, 0)] * (matrix.ndim - 2) + [(0, room), (0, room)])


def _turn(pose):
    if pose.shape[-1] == 7:
        return se3.rotation(pose)
    c, s = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    return stack_rows([c, -s], [s, c])


def _cross(a, size):
    """Derivative of R^T f by a rotation behind R, a = R^T f: [a] in the columns of the rotation, zeros elsewhere."""
    zero = jnp.zeros_like(a[..., 0])
    if size == 3:
        return stack_rows([zero, zero, a[..., 1]], [zero, zero, -a[..., 0]], [zero, zero, zero])
    x, y, z, none = a[..., 0], a[..., 1], a[..., 2], [zero] * 3
    rows = [[*none, zero, -z, y], [*none, z, zero, -x], [*none, -y, x, zero]]
    return stack_rows(*rows, *[[zero] * 6] * 3)


def _quadratic(r, information):
    return jnp.sum(r * jnp.sum(information * r[..., None, :], -1), -1)


def squared_residuals(graph: PoseGraph, poses: Float[Array, "N P"]) -> Float[Array, " E"]:
    """r^T information r of every edge at `poses`, the squared Mahalanobis distances."""
    r = edge_residual(graph.group, poses[graph.i], poses[graph.j], jnp.asarray(graph.measured), graph.position)
    return _quadratic(r, jnp.asarray(graph.information))


def edge_costs(graph: PoseGraph, poses: Float[Array, "N P"], kernel: Kernel, width: Width) -> Float[Array, " E"]:
    """Cost rho(s) of robust edges, s of the others, s = squared residual; the sum is the cost `solve` reports."""
    s = squared_residuals(graph, poses)
    return jnp.where(graph.robust, rho(kernel, s, width), s)


def _mv(a, b):
    return jnp.sum(a * b[..., None, :], -1)


def _terms(graph, poses):
    """i_from_j, residual, its transposed Jacobian by pose j, and transposed adjoint of j_from_i, per edge."""
    lie = graph.lie
    i_from_j = _once(lie.compose(lie.inverse(poses[graph.i]), poses[graph.j]))
    r = _once(_residual(lie, i_from_j, jnp.asarray(graph.measured), graph.position))
    jb_t = lie.log_jacobian(r).swapaxes(-1, -2)
    if graph.position is not None:
        turned_back = _corner(_turn(i_from_j).swapaxes(-1, -2), lie.dim)
        jb_t = jnp.where(jnp.asarray(graph.position)[:, None, None], turned_back, jb_t)
    jb_t = _once(jb_t)
    return i_from_j, r, jb_t, _once(lie.adjoint(lie.inverse(i_from_j)).swapaxes(-1, -2))


def _edge_weight(graph, s, kernel, width):
    return jnp.where(graph.robust, weight(kernel, s, width), 1)


def gauss_newton_blocks(
    graph: PoseGraph,
    poses: Float[Array, "N P"],
    kernel: Kernel,
    width: Width,
    bent: Bool[Array, ""] | None = None,
) -> EdgeBlocks:
    """Blocks of J^T W J and J^T W r with W = rho'(s) * information, the reweighted (IRLS) approximation.

    Where `bent`, W takes in the kernel's curvature, 2 rho''(s) information r r^T information, as far as it leaves W
    positive semidefinite: near the optimum that saves most of the steps which reweighting alone needs.
    """
    _, r, jb_t, ad_t = _terms(graph, poses)
    pulled = _mv(graph.information, r)
    s = jnp.sum(r * pulled, -1)
    scale, bend = _slopes(graph, s, kernel, width)
    metric = graph.information * scale[:, None, None]
    if bent is not None and kernel != "none":
        bend = jnp.where(bent, jnp.maximum(2 * bend, -scale / jnp.maximum(s, jnp.finfo(s.dtype).tiny)), 0)
        metric = metric + bend[:, None, None] * pulled[:, :, None] * pulled[:, None, :]
    jj = _once(small_matmul(_once(small_matmul(jb_t, _once(metric))), jb_t.swapaxes(-1, -2)))
    return _spread(jj, jj, ad_t, _mv(jb_t, scale[:, None] * pulled))


def _slopes(graph, s, kernel, width):
    """First and second derivative of rho at every edge."""
    return jax.jvp(lambda s: _edge_weight(graph, s, kernel, width), (s,), (jnp.ones_like(s),))


def _spread(jj, cross, ad_t, gj):
    """Carries the block of pose j to pose i, which moves the edge by -Ad(j_from_i)."""
    ij = _once(-small_matmul(ad_t, cross))
    return EdgeBlocks(small_matmul(small_matmul(ad_t, jj), ad_t.swapaxes(-1, -2)), ij, jj, -_mv(ad_t, gj), gj)


class Sensitivity(NamedTuple):
    """What `gradient_change` shares with `exact_blocks`, per edge: g_j = jb_t force(r), and its derivative by pose j.

    `by_r`, the derivative by the residual alone, is there if edges measure positions.
    """

    i_from_j: Float[Array, "E P"]
    r: Float[Array, "E d"]
    pulled: Float[Array, "E d"]
    scale: Float[Array, " E"]
    bend: Float[Array, " E"]
    jb_t: Float[Array, "E d d"]
    ad_t: Float[Array, "E d d"]
    by_j: Float[Array, "E d d"]
    by_r: Float[Array, "E d d"] | None
    gj: Float[Array, "E d"]


def exact_blocks(
    graph: PoseGraph, poses: Float[Array, "N P"], kernel: Kernel, width: Width
) -> tuple[EdgeBlocks, Sensitivity]:
    """Blocks of the true Hessian of half the cost, the curvature of the kernel and of the residual included.

    With g = J^T rho' information r the gradient at pose j, the Hessian there is the symmetric part of its derivative by
    pose j, whose other part is minus half of the bracket g . [u, v] of two perturbations; between i and j the bracket
    adds half of its matrix.
    """
    lie = graph.lie
    i_from_j, r, jb_t, ad_t = _terms(graph, poses)
    pulled = _mv(graph.information, r)
    s = jnp.sum(r * pulled, -1)
    scale, bend = _slopes(graph, s, kernel, width)
    force = _once(scale[:, None] * pulled)
    metric = graph.information * scale[:, None, None]
    metric = _once(metric + 2 * bend[:, None, None] * pulled[:, :, None] * pulled[:, None, :])
    by_r = _once(small_matmul(jb_t, metric))
    turned = lie.log_jacobian_turn(r, force)
    gj = _once(_mv(jb_t, force))
    if graph.position is None:
        by_j = small_matmul(_once(turned + by_r), jb_t.swapaxes(-1, -2))
    else:
        at = jnp.asarray(graph.position)[:, None, None]
        by_j = small_matmul(_once(jnp.where(at, 0, turned) + by_r), jb_t.swapaxes(-1, -2))
        by_j = by_j + jnp.where(at, _cross(gj, lie.dim), 0)
    jj = _once(by_j)
    halves = jnp.asarray(lie.bracket / 2, r.dtype)[None]
    bracket = sum(halves[..., m] * gj[:, m, None, None] for m in range(lie.dim))
    blocks = _spread(_once(jj + bracket), _once(jj + 2 * bracket), ad_t, gj)
    by_r = None if graph.position is None else by_r
    return blocks, Sensitivity(i_from_j, r, pulled, scale, bend, jb_t, ad_t, jj, by_r, gj)


def gradient_change(
    graph: PoseGraph,
    poses: Float[Array, "N P"],
    kernel: Kernel,
    width: Width,
    at: Sensitivity,
    change: Sequence[Array | None],
) -> tuple[Float[Array, "E d"], Float[Array, "E d"]]:
    """Derivative of both gradients of every edge, linear in `change` of poses, measured, information and width.

    None is no change. g_i = -Ad^T g_j; exp(tangent) in front of i_from_j is exp(Ad(j_from_i) tangent) behind it, as if
    pose j moved. In front of measured a tangent does the opposite; a measured position changes the residual alone.
    """
    lie = graph.lie
    d_poses, d_measured, d_information, d_width = change
    measured = jnp.asarray(graph.measured)
    gi_dot, gj_dot, front = jnp.zeros_like(at.gj), jnp.zeros_like(at.gj), jnp.zeros_like(at.r)
    if d_poses is not None:
        _, moved = jax.jvp(lambda x: lie.compose(lie.inverse(x[graph.i]), x[graph.j]), (poses,), (d_poses,))
        _, ad_dot = jax.jvp(lambda x: lie.adjoint(lie.inverse(x)), (at.i_from_j,), (moved,))
        gi_dot -= _mv(ad_dot.swapaxes(-1, -2), at.gj)
        front += lie.left_tangent(at.i_from_j, moved)
    if d_measured is not None:
        against = lie.left_tangent(measured, d_measured)
        if at.by_r is not None:
            places = jnp.asarray(graph.position)[:, None]
            against = jnp.where(places, 0, against)
            gj_dot -= _mv(at.by_r, jnp.where(places, _padded(_translation(d_measured), lie.dim), 0))
        front -= against
    gj_dot += _mv(at.by_j, _mv(at.ad_t.swapaxes(-1, -2), front))
    if d_information is not None:
        d_pulled = _mv(d_information, at.r)
        d_scale = at.bend * jnp.sum(at.r * d_pulled, -1)
        gj_dot += _mv(at.jb_t, d_scale[:, None] * at.pulled + at.scale[:, None] * d_pulled)
    if d_width is not None:
        s = jnp.sum(at.r * at.pulled, -1)
        _, d_scale = jax.jvp(lambda w: _edge_weight(graph, s, kernel, w), (width,), (d_width,))
        gj_dot += d_scale[:, None] * _mv(at.jb_t, at.pulled)
    return gi_dot - _mv(at.ad_t, gj_dot), gj_dot
