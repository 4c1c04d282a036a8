import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from ebjax.features.blobs import SIGMA_PX, erode, find_blobs, responses


def texture(size=(120, 150), seed=0, scale=2.0):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(size), scale)
    return ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


def everywhere(image):
    return jnp.ones(image.shape, bool)


def test_response_is_the_determinant_of_scipys_hessian():
    grey = texture()
    with jax.enable_x64(True):
        ours = np.asarray(responses(jnp.asarray(grey, jnp.float64), everywhere(grey)))
    smooth = gaussian_filter(np.float64(grey), SIGMA_PX, truncate=8)
    gx = np.gradient(smooth, axis=1)
    xx, yy = np.diff(smooth, 2, axis=1)[1:-1], np.diff(smooth, 2, axis=0)[:, 1:-1]
    xy = np.gradient(gx, axis=0)[1:-1, 1:-1]
    theirs = np.maximum(xx * yy - xy**2, 0) * SIGMA_PX**4
    np.testing.assert_allclose(ours[16:-16, 16:-16], theirs[15:-15, 15:-15], atol=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_bright_and_dark_spots_are_found_first_and_sharply(sign):
    centres = np.array([[20.3, 14.6], [51.5, 20.2], [33.8, 41.1]])
    x, y = np.meshgrid(np.arange(80.0), np.arange(60.0))
    image = 0.5 + sign * sum(0.4 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * 3.0**2)) for a, b in centres)
    found, strength, valid = find_blobs(jnp.asarray(image, jnp.float32), everywhere(image), count=3)
    assert valid.all() and (np.diff(strength) <= 0).all()
    distance = np.linalg.norm(np.asarray(found)[:, None] - centres[None], axis=2)
    assert distance.min(1).max() < 0.1 and sorted(distance.argmin(1)) == [0, 1, 2]


def test_an_edge_and_a_slope_are_no_blobs():
    edge = np.full((60, 80), 0.2, np.float32)
    edge[:, 40:] = 0.8
    slope = np.broadcast_to(np.linspace(0, 1, 80, dtype=np.float32), (60, 80))
    for image in (edge, slope, np.full((60, 80), 0.4, np.float32)):
        assert not find_blobs(jnp.asarray(image), everywhere(image), count=20)[2].any()


def test_subpixel_position_follows_a_shift():
    grey = texture()
    moved = shift(grey, (-0.3, 0.4), order=5, mode="nearest")
    one, _, ok = find_blobs(jnp.asarray(grey), everywhere(grey), count=60)
    two, _, also = find_blobs(jnp.asarray(moved), everywhere(grey), count=60)
    one, two = np.asarray(one)[np.asarray(ok)], np.asarray(two)[np.asarray(also)]
    difference = two[np.linalg.norm(one[:, None] - two[None], axis=2).argmin(1)] - one
    near = np.linalg.norm(difference, axis=1) < 1.5
    assert near.mean() > 0.8
    assert np.median(np.abs(difference[near] - [0.4, -0.3])) < 0.1
    np.testing.assert_allclose(np.median(difference[near], axis=0), [0.4, -0.3], atol=0.03)


def test_they_are_found_again_more_often_than_corners():
    """In other light, blur and noise, as from the other side."""
    rng = np.random.default_rng(3)
    scene = gaussian_filter(rng.standard_normal((200, 200)), 1.0) + 2 * gaussian_filter(
        rng.standard_normal((200, 200)), 4
    )
    scene = 0.5 + 0.1 * scene / scene.std()
    ramp = np.linspace(0.5, 1.2, 200)[:, None]
    views = [
        np.clip(gain * gaussian_filter(scene, blur) + 0.02 * rng.standard_normal(scene.shape), 0, 1).astype(np.float32)
        for gain, blur in ((1.0, 0.7), (ramp, 2.0))
    ]

    def again(one, two):
        return np.mean(np.linalg.norm(one[:, None] - two[None], axis=2).min(1) < 1)

    ours = [find_blobs(jnp.asarray(view), everywhere(view), count=300) for view in views]
    ours = [np.asarray(points)[np.asarray(valid)] for points, _, valid in ours]
    theirs = [cv2.goodFeaturesToTrack(view, len(ours[0]), 1e-4, 3, blockSize=5)[:, 0] for view in views]
    assert again(*ours) > 1.5 * again(*theirs) and again(*ours) > 0.5


def test_what_is_not_seen_says_nothing():
    grey = texture()
    seen = np.ones(grey.shape, bool)
    seen[:, 70:] = False
    points, strength, valid = find_blobs(jnp.asarray(grey), jnp.asarray(seen), count=200)
    assert valid.any() and (np.asarray(points)[np.asarray(valid), 0] < 65).all()
    other = find_blobs(jnp.asarray(np.where(seen, grey, 0.9)), jnp.asarray(seen), count=200)
    np.testing.assert_array_equal(points, other[0])
    np.testing.assert_array_equal(strength, other[1])


def test_they_keep_their_distance():
    points, _, valid = find_blobs(jnp.asarray(texture()), jnp.ones((120, 150), bool), count=300, radius=4)
    points = np.asarray(points)[np.asarray(valid)]
    apart = np.abs(points[:, None] - points[None]).max(2) + 99 * np.eye(len(points))
    assert len(points) > 20 and apart.min() > 3


def test_erode_is_opencvs():
    seen = np.random.default_rng(0).random((40, 50)) > 0.02
    kernel = np.ones((5, 5), np.uint8)
    theirs = cv2.erode(seen.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    np.testing.assert_array_equal(erode(jnp.asarray(seen), 2), theirs > 0)
