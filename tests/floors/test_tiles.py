from dataclasses import replace

import jax
import jax.numpy as jnp
import pytest

from ebjax.floors.tiles import TileConfig, check, tile_floor
from ebjax.floors.wear import KINDS
from ebjax.floors.wear import paint as paint_eagerly

paint = jax.jit(paint_eagerly, static_argnums=(1, 2))

SMALL = TileConfig(tile_m=0.4, texel_m=0.02, grout_m=0.02, distinct_tiles=2)


def test_floor_is_a_function_of_its_key():
    floor = tile_floor(2.0, 1.0, SMALL, key=jax.random.key(3))
    assert floor.shape == (50, 100, 3) and floor.dtype == jnp.float32
    assert floor.min() > 0 and floor.max() < 1 and floor.std() > 0.02
    assert jnp.all(floor == tile_floor(2.0, 1.0, SMALL, key=jax.random.key(3)))
    assert jnp.any(floor != tile_floor(2.0, 1.0, SMALL, key=jax.random.key(4)))


def test_without_disorder_dirt_and_wear_places_are_aliased():
    config = replace(SMALL, disorder=0.0, dirt=0.0, wear_per_m2=0.0)
    floor = tile_floor(3.2, 1.0, config, key=jax.random.key(0))
    period = 2 * 20
    assert jnp.abs(floor[:, period:] - floor[:, :-period]).max() < 1e-4
    assert jnp.abs(floor[:, 20:] - floor[:, :-20]).max() > 0.1


def test_each_kind_of_mark_is_visible_and_stays_in_its_patch():
    axis = jnp.linspace(-0.5, 0.5, 101)
    for kind in KINDS.values():
        grid = kind.patch_m * jnp.stack(jnp.meshgrid(axis, axis), axis=-1)
        paint_one = jax.jit(jax.vmap(lambda k, kind=kind, grid=grid: kind.paint(k, grid)))
        opacity, colour = paint_one(jax.random.split(jax.random.key(0), 20))
        assert jnp.all((opacity >= 0) & (opacity <= 1)) and jnp.all((colour >= 0) & (colour <= 1))
        assert jnp.all(opacity.max((1, 2)) > 0.1)
        border = jnp.concatenate([opacity[:, 0], opacity[:, -1], opacity[:, :, 0], opacity[:, :, -1]], axis=1)
        assert jnp.mean(border > 0.05) < 0.05


def test_marks_reach_the_border_and_their_number_follows_the_density():
    floor = jnp.full((100, 200, 3), 0.6)
    few, many = (jnp.any(paint(floor, n, 0.01, key=jax.random.key(0)) < 0.55, axis=-1) for n in (2.0, 30.0))
    assert 0.001 < few.mean() < 0.3 * many.mean()
    assert many[0].any() and many[-1].any()


@pytest.mark.parametrize("key, value", [("tile_m", -1.0), ("grout_m", 0.9), ("disorder", 1.5), ("wear_per_m2", -1.0)])
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"floor.{key} is"):
        check(replace(TileConfig(), **{key: value}))
