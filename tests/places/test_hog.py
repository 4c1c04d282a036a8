"""HOG against a loop over pixels, and its turn by pi."""

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.places.hog import CELL_PX, CLIP, ORIENTATIONS, blocks, histograms, rotate_pi_blocks

HEIGHT, WIDTH = 70, 52
hog = jax.jit(lambda grey, seen: blocks(histograms(grey, seen)))


def by_loop(grey, seen):
    rows, columns = HEIGHT // CELL_PX, WIDTH // CELL_PX
    cells, shown = np.zeros((rows, columns, ORIENTATIONS)), np.zeros((rows, columns))
    for y in range(1, HEIGHT - 1):
        for x in range(1, WIDTH - 1):
            if not (seen[y, x - 1] and seen[y, x + 1] and seen[y - 1, x] and seen[y + 1, x]):
                continue
            gx, gy = grey[y, x + 1] - grey[y, x - 1], grey[y + 1, x] - grey[y - 1, x]
            turn = np.arctan2(gy, gx) % np.pi / np.pi * ORIENTATIONS
            low = int(np.floor(turn))
            for row in range(rows):
                for column in range(columns):
                    dy = abs(y - ((HEIGHT - 1) / 2 + (row - (rows - 1) / 2) * CELL_PX)) / CELL_PX
                    dx = abs(x - ((WIDTH - 1) / 2 + (column - (columns - 1) / 2) * CELL_PX)) / CELL_PX
                    share = max(0, 1 - dy) * max(0, 1 - dx)
                    shown[row, column] += share / CELL_PX**2
                    for bin_, weight in ((low, 1 - turn + low), (low + 1, turn - low)):
                        cells[row, column, bin_ % ORIENTATIONS] += share * weight * np.hypot(gx, gy)
    found = np.zeros((rows - 1, columns - 1, 4 * ORIENTATIONS))
    for row in range(rows - 1):
        for column in range(columns - 1):
            if shown[row : row + 2, column : column + 2].mean() >= 0.5:
                block = cells[row : row + 2, column : column + 2].reshape(-1)
                block = np.minimum(block / np.sqrt(block @ block + 1e-6), CLIP)
                found[row, column] = block / np.sqrt(block @ block + 1e-6)
    return found


def test_hog_is_the_loop(floor_texture):
    grey, seen = floor_texture((HEIGHT, WIDTH), 4).astype(np.float64), np.ones((HEIGHT, WIDTH))
    seen[:40, :30] = 0
    expected = by_loop(grey, seen)
    assert not expected[0, 0].any() and expected[1, 1].any()
    np.testing.assert_allclose(hog(jnp.asarray(grey), jnp.asarray(seen)), expected, atol=1e-6)


def test_blocks_of_the_turned_view_are_the_turned_blocks(floor_texture):
    grey, seen = floor_texture((HEIGHT, WIDTH), 5), np.ones((HEIGHT, WIDTH), np.float32)
    seen[:20, 10:40] = 0
    turned = hog(jnp.asarray(np.rot90(grey, 2).copy()), jnp.asarray(np.rot90(seen, 2).copy()))
    np.testing.assert_allclose(turned, rotate_pi_blocks(hog(jnp.asarray(grey), jnp.asarray(seen))), atol=1e-5)


def test_flat_floor_has_no_direction_and_a_finite_gradient():
    flat, seen = jnp.full((HEIGHT, WIDTH), 0.5), jnp.ones((HEIGHT, WIDTH))
    assert not np.asarray(hog(flat, seen)).any()
    assert np.isfinite(jax.jit(jax.grad(lambda grey: hog(grey, seen).sum()))(flat)).all()
