"""The correlation of pairs against sums over cells, and against `correlate` where both maps see the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.correlation import MIN_OVERLAP, correlate, overlap_weight, spectrum
from ebjax.places.descriptor_map import MapSpace
from ebjax.places.pairwise import correlate_rows
from ebjax.places.pairwise import spectrum as map_spectrum


def correlate_pairs(queries, query_weights, references, reference_weights):
    """The first half of the references against the first query, the other half against the second."""
    straight, turned = (map_spectrum(m, w) for m, w in zip(queries, query_weights, strict=True))
    held = [map_spectrum(m, w) for m, w in zip(references, reference_weights, strict=True)]
    held = jax.tree.map(lambda *leaves: jnp.stack(leaves), *held)
    score, shift = correlate_rows(straight, turned, held, np.arange(len(references)).reshape(2, -1))
    return np.asarray(score).ravel(), np.asarray(shift).reshape(-1, 2)


def drawn(count, size, channels, seed, hidden=0.2):
    rng = np.random.default_rng(seed)
    maps = rng.integers(-127, 128, (count, *size, channels)).astype(np.int8)
    weights = rng.integers(1, 256, (count, *size)).astype(np.uint8)
    weights[rng.random(weights.shape) < hidden] = 0
    return np.where(weights[..., None] > 0, maps, 0).astype(np.int8), weights


def by_sums(a, a_weight, b, b_weight):
    """The best score over all shifts, and its shift."""
    a, b = (m * (w / (127 * 255))[..., None] for m, w in ((a, a_weight), (b, b_weight)))
    height, width = a_weight.shape
    cells, best = max((a_weight > 0).sum(), (b_weight > 0).sum()), (-1.0, None)
    for dy in range(1 - height, height):
        for dx in range(1 - width, width):
            at = np.s_[max(dy, 0) : height + min(dy, 0), max(dx, 0) : width + min(dx, 0)]
            on = np.s_[max(-dy, 0) : height + min(-dy, 0), max(-dx, 0) : width + min(-dx, 0)]
            both = (a_weight[at] > 0) & (b_weight[on] > 0)
            overlap = both.sum() / cells
            if overlap <= MIN_OVERLAP:
                continue
            energy = (a[at][both] ** 2).sum() * (b[on][both] ** 2).sum()
            score = (a[at] * b[on]).sum() / np.sqrt(energy) * np.sqrt(overlap)
            best = max(best, (score, (dy, dx)))
    return best


@pytest.mark.parametrize(("size", "channels", "hidden"), [((6, 7), 3, 0.2), ((5, 4), 6, 0.0), ((7, 7), 2, 0.5)])
def test_the_best_score_and_shift_are_those_of_the_sums(size, channels, hidden):
    queries, ours = drawn(2, size, channels, 0, hidden)
    references, theirs = drawn(6, size, channels, 1, hidden)
    references[1, 1:], theirs[1, 1:] = queries[0, :-1], ours[0, :-1]
    score, shift = map(np.asarray, correlate_pairs(queries, ours, references, theirs))
    for k in range(6):
        expected, at = by_sums(queries[k // 3], ours[k // 3], references[k], theirs[k])
        assert score[k] == pytest.approx(expected, abs=1e-4)
        assert tuple(shift[k]) == at
    assert tuple(shift[1]) == (-1, 0) and score[1] > 0.7


def test_turning_the_query_is_turning_the_reference_with_the_shift_reversed():
    size, parity = (8, 6), np.array([1, 1, -1, -1])
    maps, _ = drawn(4, size, 4, 2, 0.0)
    weights = np.full((4, *size), 255, np.uint8)
    turned = (maps[0][::-1, ::-1] * parity).astype(np.int8)
    queries = np.stack([maps[0], turned])
    score, shift = correlate_pairs(
        queries, weights[:2], np.concatenate([maps[1:], maps[1:]]), np.repeat(weights, 2, 0)[:6]
    )
    space = MapSpace(jnp.zeros((*size, 4)), jnp.eye(4), jnp.asarray(parity, float), jnp.ones(size))
    spectra = [spectrum(jnp.asarray(one / 127), space) for one in maps]
    for way in (0, 1):
        sign = -1 if way else 1
        for k in range(3):
            stacked = type(spectra[0])(*(leaf[None] for leaf in vars(spectra[k + 1]).values()))
            expected, at = correlate(spectra[0], stacked, overlap_weight(space), space, opposing=bool(way))
            assert float(score[3 * way + k]) == pytest.approx(float(expected[0]), abs=1e-4)
            np.testing.assert_array_equal(sign * np.asarray(shift[3 * way + k]), np.asarray(at[0]))


def test_maps_that_see_nothing_score_nothing():
    maps, weights = drawn(2, (5, 5), 2, 3)
    score, _ = correlate_pairs(maps, weights, np.zeros_like(maps), np.zeros_like(weights))
    np.testing.assert_array_equal(score, -1)
