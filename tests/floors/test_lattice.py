import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors import lattice

entry = jax.jit(lattice.entry, static_argnums=2)


def square(column, row, side=64):
    return jnp.meshgrid(jnp.arange(column, column + side), jnp.arange(row, row + side))


@pytest.mark.parametrize("home", [64.0, 640.0, None])
def test_at_home_entries_follow_in_order(home):
    column, row = square(-8, -8)
    found = entry(column, row, (64, 64), home)
    assert jnp.all(found == (row % 64) * 64 + column % 64)
    assert jnp.all(entry(column + 64, row, (64, 64), home) == found) == (home != 64)


def test_beyond_home_nothing_repeats():
    start = entry(*square(-8, -8), (64, 64), 64.0)
    rng = np.random.default_rng(0)
    places = [
        (64, 0),
        (0, 64),
        (-64, -64),
        (4096, 0),
        (1 << 16, 0),
        (0, 1 << 16),
        *rng.integers(-200000, 200000, (30, 2)),
    ]
    for column, row in places:
        found = entry(*square(column - 8, row - 8), (64, 64), 64.0)
        counts = np.bincount(np.asarray(found).reshape(-1), minlength=4096)
        assert counts.max() < 12 and (counts > 0).mean() == pytest.approx(1 - np.exp(-1), abs=0.04)
        for other in (start, entry(*square(column + 56, row - 8), (64, 64), 64.0)):
            assert jnp.mean(found == other) < 0.005


def test_a_column_of_a_table_is_enough():
    row = jnp.arange(-5, 500)
    found = entry(row, jnp.zeros_like(row), (128, 1), 128.0)
    assert jnp.all(found[:117] == row[:117] % 128)
    assert len(np.unique(found[117:])) > 110 and jnp.mean(found[128:] == found[:-128]) < 0.05
