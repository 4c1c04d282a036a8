import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates, maximum_filter

from ebjax.models.detect import (
    inside,
    soft_argmax,
    strongest,
    suppress_greedily,
    suppress_twice,
    window_max,
)
from ebjax.models.resize import resize


def noise(size=(37, 41), seed=0, levels=None):
    values = np.random.default_rng(seed).random(size)
    return values if levels is None else np.round(values * levels) / levels


def greedy(scores, candidates, radius):
    """One by one, the best first; of equal ones the first in raster order."""
    free, kept = candidates.copy(), np.zeros_like(candidates)
    for index in np.argsort(-scores.reshape(-1), kind="stable"):
        y, x = divmod(int(index), scores.shape[1])
        if free[y, x]:
            free[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1] = False
            kept[y, x] = True
    return kept


@pytest.mark.parametrize("radius", [1, 4])
@pytest.mark.parametrize("levels", [None, 5, 1])
def test_greedy_suppression_is_greedy_also_among_equals(radius, levels):
    scores = noise(levels=levels)
    candidates = scores > 0.3
    found = jax.jit(suppress_greedily, static_argnums=2)(jnp.asarray(scores), jnp.asarray(candidates), radius)
    np.testing.assert_array_equal(found, greedy(scores, candidates, radius))


def test_greedy_suppression_of_many_maps_at_once():
    scores = np.stack([noise(seed=k) for k in range(3)])
    found = jax.vmap(lambda s: suppress_greedily(s, s > 0.5, 3))(jnp.asarray(scores))
    for one, mine in zip(scores, found, strict=True):
        np.testing.assert_array_equal(mine, greedy(one, one > 0.5, 3))


def test_two_rounds_find_local_maxima_and_those_they_leave_over():
    scores = noise()
    found = np.asarray(suppress_twice(jnp.asarray(scores), 3))
    best = scores == maximum_filter(scores, 7, mode="constant")
    assert (found >= best).all() and found.sum() > best.sum()
    everything = greedy(scores, np.ones_like(best), 3)
    assert (found <= everything).all() and found.sum() > 0.95 * everything.sum()
    assert np.asarray(suppress_twice(jnp.ones((5, 6)), 2)).all()  # equal neighbours all stay, as published


def test_window_max_is_the_square_filter():
    scores = noise()
    np.testing.assert_array_equal(window_max(jnp.asarray(scores), 2), maximum_filter(scores, 5, mode="constant"))


def test_strongest_come_first_and_all_fit():
    scores = noise()
    mask = scores > 0.5
    pixels, valid = strongest(jnp.asarray(scores), jnp.asarray(mask), 10**6)
    assert valid.shape == (scores.size,) and valid.sum() == mask.sum()
    x, y = np.asarray(pixels)[np.asarray(valid)].T
    np.testing.assert_array_equal(scores[y, x], np.sort(scores[mask])[::-1])
    few, _ = strongest(jnp.asarray(scores), jnp.asarray(mask), 7)
    np.testing.assert_array_equal(few, pixels[:7])


def test_inside_leaves_out_each_border():
    expected = np.zeros((9, 12), bool)
    expected[2:8, 2:9] = True
    np.testing.assert_array_equal(inside((9, 12), 2, (1, 3)), expected)


def test_soft_argmax_finds_a_peak_between_pixels_and_has_its_gradient():
    y, x = np.mgrid[:11, :13]
    peak = np.array([6.2, 4.7])
    scores = jnp.asarray(np.exp(-((x - peak[0]) ** 2 + (y - peak[1]) ** 2) / 4))
    pixels = jnp.array([[6, 5]])
    np.testing.assert_allclose(soft_argmax(scores, pixels, 2, 0.1)[0], peak, atol=0.05)
    step = jnp.asarray(noise((11, 13)) - 0.5)

    def place(t):
        return soft_argmax(scores + t * step, pixels, 2, 0.1).sum()

    numeric = (place(1e-5) - place(-1e-5)) / 2e-5
    np.testing.assert_allclose(jax.grad(place)(0.0), numeric, rtol=1e-6)


@pytest.mark.parametrize("size", [(9, 5), (30, 41), (1, 7), (17, 13)])
def test_resize_keeps_the_corners(size):
    image = noise((17, 13, 2))
    rows, columns = (np.linspace(0, n - 1, m) if m > 1 else np.zeros(1) for n, m in zip((17, 13), size, strict=True))
    at = np.meshgrid(rows, columns, indexing="ij")
    expected = np.stack([map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(2)], -1)
    np.testing.assert_allclose(resize(jnp.asarray(image), size), expected, atol=1e-12)
    assert resize(jnp.asarray(image[None], jnp.float32), size).dtype == jnp.float32
