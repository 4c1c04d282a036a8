"""Alignment of matched corners in floor views."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from ebjax.features.align import MOST_PX, aligned

SIZE = 120
TEXTURE = gaussian_filter(np.random.default_rng(0).standard_normal((3 * SIZE, 3 * SIZE)), 1.5) * 260
SEEN = jnp.ones((SIZE, SIZE), bool)
align = jax.jit(aligned)


def rendered(image_from_texture, contrast=1.0, noise=0.0):
    """A view of the texture, by SciPy's splines (cv2's warp rounds to 1/32 px)."""
    pixels = np.stack(np.meshgrid(np.arange(float(SIZE)), np.arange(float(SIZE))), -1).reshape(-1, 2)
    x, y = at(np.linalg.inv(image_from_texture), pixels).T
    view = map_coordinates(TEXTURE, [y, x], order=3, mode="reflect").reshape(SIZE, SIZE) * contrast
    view = view + noise * np.random.default_rng(1).standard_normal(view.shape)
    return np.clip(np.round(128 + view), 0, 255).astype(np.uint8)


def motion(degrees, x, y, scale=1.0):
    c, s = scale * np.cos(np.radians(degrees)), scale * np.sin(np.radians(degrees))
    return np.array([[c, -s, x], [s, c, y], [0, 0, 1.0]])


def at(homography, points):
    moved = np.concatenate([points, np.ones((len(points), 1))], 1) @ homography.T
    return moved[:, :2] / moved[:, 2:]


def grid(margin=30):
    steps = np.arange(margin, SIZE - margin + 1, 6.0)
    return np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) + 0.3


FIRST = motion(0, -SIZE, -SIZE)


@pytest.mark.parametrize("degrees", [0, 12, 180, 197])
def test_points_come_back_to_where_the_patches_fit(degrees):
    middle = motion(0, SIZE / 2, SIZE / 2) @ motion(degrees, 3.4, -2.7) @ motion(0, -SIZE / 2, -SIZE / 2)
    one, other = rendered(middle @ FIRST), rendered(FIRST)
    partners = grid()
    true = at(middle, partners)
    begun = true + np.random.default_rng(2).uniform(-0.7, 0.7, true.shape)
    moved, _, found = align(one, other, SEEN, middle, begun, partners)
    assert found.mean() > 0.9
    off = np.linalg.norm(np.asarray(moved - true)[np.asarray(found)], axis=1)
    assert np.median(off) < 0.03 and np.quantile(off, 0.95) < 0.15


def test_contrast_that_falls_along_the_view_does_not_pull_and_brightness_does_not_matter():
    fall = np.exp(-np.arange(SIZE) / 60)[:, None] * np.ones((1, SIZE))
    shift = motion(0, 0.4, 15.3)
    one = np.clip(rendered(shift @ FIRST, fall).astype(float) * 0.6 + 70, 0, 255).astype(np.uint8)
    other = rendered(FIRST, fall)
    partners = grid()
    true = at(shift, partners)
    moved, _, found = align(one, other, SEEN, shift, true + 0.3, partners)
    error = np.asarray(moved - true)[np.asarray(found)]
    assert found.mean() > 0.8
    assert np.abs(np.median(error, 0)).max() < 0.03


def test_a_rough_homography_is_enough():
    shift = motion(0, 5.5, 8.2)
    one, other = rendered(shift @ FIRST, noise=2.0), rendered(FIRST)
    partners = grid()
    true = at(shift, partners)
    moved, _, found = align(one, other, SEEN, motion(1.0, 6.5, 8.0), true + 0.4, partners)
    assert np.median(np.linalg.norm(np.asarray(moved - true)[np.asarray(found)], axis=1)) < 0.08


def test_what_cannot_be_aligned_stays_where_it_was():
    view = rendered(FIRST)
    points = np.array([[3.0, 60], [60, 117], [60, 60], [90, 60]])
    seen = SEEN.at[:, 95:].set(False)
    moved, _, found = align(view, view, seen, np.eye(3), points, points)
    np.testing.assert_array_equal(found, [False, False, True, False])
    np.testing.assert_array_equal(np.asarray(moved)[[0, 1, 3]], points[[0, 1, 3]])
    far = points[2:3] + np.array([[0.0, 4.0]])
    moved, _, found = align(view, view, SEEN, np.eye(3), far, points[2:3])
    assert not found[0] or np.linalg.norm(moved - far) < MOST_PX
    lost, _, found = align(view, view, SEEN, np.full((3, 3), np.nan), points, points)
    assert not found.any()
    np.testing.assert_array_equal(lost, points)
    flat = np.full((SIZE, SIZE), 90, np.uint8)
    still, _, _ = align(flat, flat, SEEN, np.eye(3), points, points)
    np.testing.assert_array_equal(still, points)


def test_a_view_smaller_than_a_patch_is_left_alone():
    points = np.array([[4.0, 4.0]])
    view = np.zeros((9, 9), np.uint8)
    moved, _, found = align(view, view, np.ones((9, 9), bool), np.eye(3), points, points)
    assert not found.any()
    np.testing.assert_array_equal(moved, points)
