"""Correlation against a loop over all shifts, and what a shift means on the floor."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.places.correlation import MIN_OVERLAP, OVERLAP_POWER, correlate, overlap_weight, spectrum
from ebjax.places.descriptor_map import STRIDE_PX, MapSpace, learn_space, project, rotate_pi_map

SIZE = 96
correlate, spectrum, overlap_weight = (
    jax.jit(correlate, static_argnames="opposing"),
    jax.jit(spectrum),
    jax.jit(overlap_weight),
)


def by_loop(query, reference, mask_q, mask_r):
    """Scores of every shift, shift -> score: one Python loop, no FFT."""
    rows, columns = mask_q.shape
    scores = {}
    for dy in range(1 - rows, rows):
        for dx in range(1 - columns, columns):
            dot = energy_q = energy_r = cells = 0.0
            for y in range(max(0, -dy), min(rows, rows - dy)):
                for x in range(max(0, -dx), min(columns, columns - dx)):
                    both = mask_q[y + dy, x + dx] * mask_r[y, x]
                    dot += query[y + dy, x + dx] @ reference[y, x]
                    energy_q += both * (query[y + dy, x + dx] @ query[y + dy, x + dx])
                    energy_r += both * (reference[y, x] @ reference[y, x])
                    cells += both
            overlap = cells / mask_q.sum()
            if overlap > MIN_OVERLAP:
                scores[dy, dx] = dot / np.sqrt(energy_q * energy_r) * overlap**OVERLAP_POWER
    return scores


@pytest.mark.parametrize("opposing", [False, True])
def test_correlation_is_the_best_of_all_shifts(opposing):
    rng = np.random.default_rng(5)
    mask = np.ones((5, 6))
    mask[0, :2] = mask[4, 5] = 0
    parity = np.array([1.0, -1.0, 1.0])
    space = MapSpace(*map(jnp.asarray, (np.zeros((5, 6, 3)), np.eye(3), parity, mask)))
    queries, references = (rng.standard_normal((4, 5, 6, 3)) * mask[None, :, :, None] for _ in range(2))
    stacked = jax.vmap(lambda one: spectrum(one, space))(jnp.asarray(references))
    for query in queries:
        score, shift = correlate(
            spectrum(jnp.asarray(query), space), stacked, overlap_weight(space), space, opposing=opposing
        )
        for k, reference in enumerate(references):
            other = np.asarray(rotate_pi_map(jnp.asarray(reference), space)) if opposing else reference
            scores = by_loop(query, other, mask, mask[::-1, ::-1] if opposing else mask)
            best = max(scores, key=lambda at: scores[at])
            np.testing.assert_allclose(score[k], scores[best], rtol=1e-9)
            assert tuple(np.asarray(shift[k])) == best


def test_a_map_matches_itself_in_place(maps, space):
    ours = spectrum(project(maps[0], space), space)
    stacked = jax.tree.map(lambda leaf: leaf[None], ours)
    score, shift = correlate(ours, stacked, overlap_weight(space), space, opposing=False)
    np.testing.assert_allclose(score, 1, atol=1e-5)
    assert not np.asarray(shift).any()
    assert score.dtype == jnp.float32


@pytest.mark.parametrize("opposing", [False, True])
@pytest.mark.parametrize("ahead, left", [(3, 0), (0, -2), (-4, 2)])
def test_shift_is_how_far_the_query_lies_ahead_and_to_the_left(floor_texture, dense_all, opposing, ahead, left):
    """A robot that has moved (dx, dy) metres, in the query's heading, between two floor views sees a shift of (dx, dy)
    over STRIDE_PX metres_per_px: up in the floor texture is ahead, left is left, as in a FloorView."""
    texture = floor_texture((200, 200), 8)
    top, edge = 52, 52

    def cut(row, column):
        return texture[row : row + SIZE, column : column + SIZE]

    reference = cut(top, edge)
    query = cut(top - ahead * STRIDE_PX, edge - left * STRIDE_PX)
    seen = jnp.ones((SIZE, SIZE), jnp.float32)
    views = [
        query,
        np.rot90(reference, 2) if opposing else reference,
        *(floor_texture((SIZE, SIZE), s) for s in range(4)),
    ]
    dense_maps = dense_all(np.stack(views), seen)
    space = learn_space(dense_maps, np.ones(dense_maps.shape[1:3], bool), 16)
    spectra = jax.jit(jax.vmap(lambda one: spectrum(project(one, space), space)))(dense_maps)
    ours, others = (jax.tree.map(lambda leaf, rows=rows: leaf[rows], spectra) for rows in (0, slice(1, None)))
    score, shift = correlate(ours, others, overlap_weight(space), space, opposing=opposing)
    assert int(np.argmax(score)) == 0 and float(score[0]) > 2 * float(np.sort(score)[-2])
    assert np.asarray(shift[0]).tolist() == [ahead, left]
