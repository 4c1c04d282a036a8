"""Turning a view by pi, describing and projecting commute; the components are those of an ordinary eigenproblem."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.rootsift import rotate_pi_descriptor
from ebjax.places.descriptor_map import STRIDE_PX, dense, grid, learn_space, project, rotate_pi_dense, rotate_pi_map

SIZE = 96


def test_grid_is_symmetric_and_spaced_by_the_stride():
    points = grid((50, 83))
    np.testing.assert_allclose(points + points[::-1, ::-1], np.broadcast_to([82.0, 49.0], points.shape))
    np.testing.assert_allclose(np.diff(points[..., 0], axis=1), STRIDE_PX)
    np.testing.assert_allclose(np.diff(points[..., 1], axis=0), STRIDE_PX)


@pytest.mark.parametrize("shape", [(SIZE, SIZE), (64, 90)])
def test_dense_of_turned_view_is_turned_dense(floor_texture, shape):
    view = floor_texture(shape, 3).astype(np.float64)
    seen = np.ones(shape)
    seen[:20, :30] = 0  # a field of view without symmetry
    values, support = jax.jit(dense)(jnp.asarray(view), jnp.asarray(seen))
    other, other_support = jax.jit(dense)(jnp.asarray(np.rot90(view, 2)), jnp.asarray(np.rot90(seen, 2)))
    np.testing.assert_allclose(other, rotate_pi_dense(values), atol=1e-5)
    np.testing.assert_allclose(other_support, support[::-1, ::-1], atol=1e-5)
    assert float(support.min()) < 0.5 < 0.99 < float(support.max()) <= 1 + 1e-6


def test_nothing_outside_the_field_of_view_counts(floor_texture):
    view, seen = floor_texture((SIZE, SIZE), 1), np.ones((SIZE, SIZE), np.float32)
    seen[:, :40] = 0
    painted = np.where(seen > 0, view, 1 - view)
    first, second = (jax.jit(dense)(jnp.asarray(image), jnp.asarray(seen))[0] for image in (view, painted))
    np.testing.assert_array_equal(first, second)


def test_projection_commutes_with_turning(maps, space):
    full = dataclasses.replace(space, mask=jnp.ones_like(space.mask))
    opposite = dataclasses.replace(full, mean=rotate_pi_dense(full.mean))
    for view in maps[:3]:
        there = project(rotate_pi_dense(view), opposite)
        np.testing.assert_allclose(there, rotate_pi_map(project(view, full), full), atol=1e-5)
    assert set(np.unique(space.parity)) == {-1.0, 1.0}


def test_turning_twice_changes_nothing(maps, space):
    np.testing.assert_array_equal(rotate_pi_dense(rotate_pi_dense(maps)), maps)
    projected = project(maps[0], space)
    np.testing.assert_array_equal(rotate_pi_map(rotate_pi_map(projected, space), space), projected)


def test_components_solve_the_symmetric_eigenproblem(maps, space):
    mask = np.asarray(space.mask)
    maps = np.asarray(maps, np.float64)
    rows = ((maps - maps.mean(0)) * mask[None, :, :, None]).reshape(-1, 256)
    opposite = np.asarray(rotate_pi_descriptor(jnp.asarray(rows.reshape(len(rows), 2, 128)))).reshape(rows.shape)
    covariance = (rows.T @ rows + opposite.T @ opposite) / (2 * len(maps) * mask.sum())
    expected = np.linalg.eigvalsh(covariance)[::-1][:16]
    basis = np.asarray(space.basis, np.float64)
    np.testing.assert_allclose(basis.T @ basis, np.eye(16), atol=1e-5)
    np.testing.assert_allclose(basis.T @ covariance @ basis, np.diag(expected), atol=1e-5 * expected[0])


def test_cells_that_do_not_count_are_zero(maps, space):
    projected = np.asarray(project(maps[0], space))
    assert not projected[np.asarray(space.mask) == 0].any()
    assert projected[np.asarray(space.mask) > 0].any(-1).all()


@pytest.mark.parametrize("dtype, expected", [("float16", "float32"), ("float32", "float32"), ("float64", "float64")])
def test_dtype_follows_the_input(maps, dtype, expected):
    space = learn_space(maps.astype(dtype), np.ones(maps.shape[1:3], bool), 8)
    assert {leaf.dtype for leaf in (space.mean, space.basis, space.parity, space.mask)} == {np.dtype(expected)}
    if dtype != "float16":
        values, support = jax.jit(dense)(jnp.zeros((24, 24), dtype), jnp.ones((24, 24), dtype))
        assert values.dtype == support.dtype == dtype
