import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from ebjax.features.corners import erode, find_corners, smaller_eigenvalue, structure_tensor


def texture(size=(120, 150), seed=0):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(size), 2.5)
    return ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


def squares():
    """A bright square whose corners are known: the edges run half a pixel outside its first and last pixel."""
    image = np.zeros((60, 80), np.float32)
    image[20:40, 25:55] = 1
    return image, np.array([[25, 20], [54, 20], [25, 39], [54, 39]])


def test_response_orders_places_as_opencv_does():
    grey = texture()
    tensor = structure_tensor(jnp.asarray(grey), jnp.ones(grey.shape, bool))
    ours = np.asarray(smaller_eigenvalue(*tensor))[10:-10, 10:-10]
    theirs = cv2.cornerMinEigenVal(cv2.GaussianBlur(grey, (3, 3), 0), 5, 3)[10:-10, 10:-10]
    # OpenCV's window is a box, ours a binomial.
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.94


def test_corners_are_opencvs_good_features():
    grey = texture()
    theirs = cv2.goodFeaturesToTrack(cv2.GaussianBlur(grey, (3, 3), 0), 40, 0.01, 6, blockSize=5)[:, 0]
    inside = (theirs > 10).all(1) & (theirs < np.array(grey.shape[::-1]) - 11).all(1)
    ours, _, valid = find_corners(jnp.asarray(grey), jnp.ones(grey.shape, bool), count=100)
    ours = np.asarray(ours)[np.asarray(valid)]
    distance = np.linalg.norm(theirs[inside, None] - ours[None], axis=2).min(1)
    assert np.mean(distance < 2) > 0.9


@pytest.mark.slow
def test_corners_of_a_square_are_found_first_and_sharply():
    image, expected = squares()
    found, strength, valid = find_corners(jnp.asarray(image), jnp.ones(image.shape, bool), count=4)
    assert valid.all() and (np.diff(strength) <= 0).all()
    distance = np.linalg.norm(np.asarray(found)[:, None] - expected[None], axis=2)
    assert distance.min(1).max() < 1.5 and sorted(distance.argmin(1)) == [0, 1, 2, 3]


def test_subpixel_position_follows_a_shift():
    grey = texture()
    moved = shift(grey, (-0.3, 0.4), order=5, mode="nearest")
    seen = jnp.ones(grey.shape, bool)
    one, _, ok = find_corners(jnp.asarray(grey), seen, count=60)
    two, _, also = find_corners(jnp.asarray(moved), seen, count=60)
    one, two = np.asarray(one)[np.asarray(ok)], np.asarray(two)[np.asarray(also)]
    difference = two[np.linalg.norm(one[:, None] - two[None], axis=2).argmin(1)] - one
    near = np.linalg.norm(difference, axis=1) < 1.5
    assert near.mean() > 0.8
    assert np.median(np.abs(difference[near] - [0.4, -0.3])) < 0.15
    np.testing.assert_allclose(np.median(difference[near], axis=0), [0.4, -0.3], atol=0.03)


def test_no_corner_near_what_is_not_seen():
    grey = texture()
    seen = np.ones(grey.shape, bool)
    seen[:, 70:] = False
    points, _, valid = find_corners(jnp.asarray(grey), jnp.asarray(seen), count=200)
    assert valid.any() and (np.asarray(points)[np.asarray(valid), 0] < 65).all()


@pytest.mark.slow
def test_corners_keep_their_distance_and_a_flat_view_has_none():
    points, _, valid = find_corners(jnp.asarray(texture()), jnp.ones((120, 150), bool), count=300, radius=4)
    points = np.asarray(points)[np.asarray(valid)]
    apart = np.abs(points[:, None] - points[None]).max(2) + 99 * np.eye(len(points))
    assert apart.min() > 3
    assert not find_corners(jnp.full((50, 60), 0.4), jnp.ones((50, 60), bool), count=20)[2].any()


def test_erode_is_opencvs():
    seen = np.random.default_rng(0).random((40, 50)) > 0.02
    kernel = np.ones((5, 5), np.uint8)
    theirs = cv2.erode(seen.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    np.testing.assert_array_equal(erode(jnp.asarray(seen), 2), theirs > 0)
