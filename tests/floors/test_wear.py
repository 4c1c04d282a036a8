import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.plan import make_plan
from ebjax.floors.wear import KINDS, paint, scatter

EAST = jnp.array([1.0, 0.0])


def painted(floor, kind, centres, direction=EAST, strength=1.0, texel=0.01):
    count = len(centres)
    arguments = jnp.asarray(centres, floor.dtype), jnp.arange(count), jnp.ones(count, bool)
    return paint(floor, kind, *arguments, direction, jnp.asarray(strength), texel, key=jax.random.key(1))


@pytest.mark.slow
def test_each_kind_of_mark_is_visible_and_stays_in_its_patch():
    axis = jnp.linspace(-0.5, 0.5, 51)
    for kind in KINDS.values():
        grid = kind.patch_m * jnp.stack(jnp.meshgrid(axis, axis), axis=-1)
        paint_one = jax.jit(jax.vmap(lambda k, kind=kind, grid=grid: kind.paint(k, grid)))
        opacity, colour = paint_one(jax.random.split(jax.random.key(0), 8))
        assert jnp.all((opacity >= 0) & (opacity <= 1)) and jnp.all((colour >= 0) & (colour <= 1))
        assert jnp.all(opacity.max((1, 2)) > 0.1)
        border = jnp.concatenate([opacity[:, 0], opacity[:, -1], opacity[:, :, 0], opacity[:, :, -1]], axis=1)
        assert jnp.mean(border > 0.05) < 0.05


def test_marks_lie_where_they_are_told_even_across_the_border():
    floor = jnp.full((60, 100, 3), 0.6)
    inside = painted(floor, "gum", [(30.0, 20.0)])
    changed = jnp.argwhere(jnp.abs(inside - floor).max(-1) > 0.05)
    np.testing.assert_allclose(changed.mean(0), [20, 30], atol=1.5)
    for centre in [(0.0, 30.0), (99.0, 59.0), (50.0, 0.0)]:
        assert jnp.any(painted(floor, "gum", [centre]) != floor)
    assert jnp.all(painted(floor, "gum", [(300.0, 30.0)]) == floor)
    assert jnp.all(painted(floor, "gum", [(30.0, 20.0)], strength=0.0) == floor)


def test_a_mark_looks_the_same_from_a_frame_that_is_turned():
    floor = jnp.full((80, 80, 3), 0.6)
    upright = painted(floor, "stain", [(40.0, 40.0)])
    # Columns to the north, rows to the west: the image turned by a quarter.
    turned = painted(floor, "stain", [(40.0, 40.0)], direction=jnp.array([0.0, 1.0]))
    assert jnp.abs(upright - 0.6).max() > 0.05
    np.testing.assert_allclose(turned[1:], jnp.transpose(upright, (1, 0, 2))[::-1][:-1], atol=1e-6)


def test_marks_are_even_over_rectangles_that_overlap():
    plan = make_plan([np.array([[0.0, 0.0], [20.0, 0.0]]), np.array([[10.0, -8.0], [10.0, 8.0]])], 2.0, 1.0)
    sizes = np.stack([plan.lengths, np.full(2, 2.0)], axis=1)
    found = scatter(
        plan.owns, plan.origins, plan.directions, sizes, 20.0, {"stain": 0.6, "gum": 0.2}, np.random.default_rng(0)
    )
    places = np.concatenate([kind.places for kind in found.values()])
    area = 22 * 2 + 18 * 2 - 4
    assert 0.9 < len(places) / (0.8 * 20 * area) < 1.1
    crossing = np.all(np.abs(places - [10, 0]) < 1, axis=1).sum()
    assert 35 < crossing < 95
    assert len(found["stain"].numbers) > 2 * len(found["gum"].numbers)
    assert not set(found["stain"].numbers) & set(found["gum"].numbers)
