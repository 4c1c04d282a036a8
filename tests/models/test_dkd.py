import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from ebjax.models.dkd import find_keypoints

PEAKS = np.array([[30.1, 20.3], [12.4, 9.1], [2.2, 25.1]])
HEIGHTS = 0.9, 0.7, 0.5


@pytest.fixture(scope="module")
def scores():
    """Three round peaks, 34 x 45."""
    y, x = np.mgrid[:34, :45]
    peaks = zip(HEIGHTS, PEAKS, strict=True)
    return jnp.asarray(sum(high * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 4) for high, (u, v) in peaks))


def test_peaks_are_found_to_a_fraction_of_a_pixel_strongest_first(scores):
    keypoints, best, valid = find_keypoints(scores, count=5, threshold=0.3)
    assert keypoints.shape == (5, 2) and valid.tolist() == [True] * 3 + [False] * 2
    np.testing.assert_allclose(keypoints[:3], PEAKS, atol=0.05)
    read = map_coordinates(scores, np.asarray(keypoints[:3]).T[::-1], order=1)
    np.testing.assert_allclose(best[:3], read, rtol=1e-12)


def test_threshold_border_and_whole_pixels(scores):
    whole, best, _ = find_keypoints(scores, count=5, threshold=0.3, sub_pixel=False)
    np.testing.assert_array_equal(whole[:3], np.round(PEAKS))
    np.testing.assert_allclose(best[:3], [scores[int(y), int(x)] for x, y in np.asarray(whole[:3])], rtol=1e-12)
    assert find_keypoints(scores, count=5, threshold=0.3, border=3)[2].sum() == 2
    assert find_keypoints(scores, count=5, threshold=0.6)[2].sum() == 2
    assert find_keypoints(scores, count=10_000, threshold=0.3)[0].shape == (34 * 45, 2)


def test_places_and_scores_are_differentiable(scores):
    step = jnp.asarray(np.random.default_rng(3).standard_normal(scores.shape))

    def value(t):
        keypoints, best, _ = find_keypoints(scores + t * step, count=3, threshold=0.3)
        return (keypoints**2).sum() + best.sum()

    np.testing.assert_allclose(jax.grad(value)(0.0), (value(1e-7) - value(-1e-7)) / 2e-7, rtol=1e-5)
