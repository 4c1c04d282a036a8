from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.atlas import locate, look, make_atlas
from ebjax.floors.laying import floor_of
from ebjax.floors.plan import make_plan
from ebjax.floors.surface import FloorConfig

CROSS = make_plan([np.array([[0.0, 0.0], [6.0, 0.0]]), np.array([[3.0, -3.0], [3.0, 3.0]])], 1.6, 1.0)
NARROW = jnp.broadcast_to(1e-3 * jnp.eye(2), (40, 40, 2, 2)).astype(jnp.float32)


def crossing():
    x, y = jnp.meshgrid(jnp.linspace(2.4, 3.6, 40), jnp.linspace(-0.6, 0.6, 40))
    return x.astype(jnp.float32), y.astype(jnp.float32)


@pytest.mark.slow
def test_corridors_that_cross_share_one_floor():
    config = FloorConfig(family="concrete", texel_m=0.02, wear_per_m2=6.0)
    one = floor_of(CROSS, config, key=jax.random.key(0))
    assert one.texture.texels.dtype == jnp.float16
    columns = [one.columns[::-1], one.origins[::-1], one.directions[::-1], one.lengths[::-1]]
    other = replace(one, columns=columns[0], origins=columns[1], directions=columns[2], lengths=columns[3])
    x, y = crossing()
    by_first, by_second = (look(atlas, locate(atlas, x, y), NARROW) for atlas in (one, other))
    assert by_first.std() > 0.01
    # Two rasters of one floor: equal up to the texel, so edges differ and most of the floor does not.
    assert jnp.median(jnp.abs(by_first - by_second)) < 0.005 and jnp.mean(jnp.abs(by_first - by_second)) < 0.01


def test_a_point_is_found_in_its_strip():
    atlas = make_atlas(np.zeros((160, 1600, 3)), [0, 800], CROSS, 0.01, jnp.float64)
    x, y = jnp.array([[1.0, 3.0, 3.5]]), jnp.array([[0.1, -2.0, 9.0]])
    ground = locate(atlas, x, y)
    np.testing.assert_allclose(ground.texel[0, 0], [2.0 / 0.01 - 0.5, 0.9 / 0.01 - 0.5])
    np.testing.assert_allclose(ground.texel[0, 1], [800 + 2.0 / 0.01 - 0.5, 0.8 / 0.01 - 0.5])
    np.testing.assert_allclose(ground.across[0, :2], [0.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(ground.clearance[0, :2], [0.7, 0.8])
    assert ground.clearance[0, 2] < 0


@pytest.mark.slow
def test_wear_and_its_strength_change_the_floor():
    config = FloorConfig(family="concrete", texel_m=0.02)
    floors = [
        floor_of(CROSS, replace(config, wear_per_m2=n, wear=s), key=jax.random.key(0)).texture.texels
        for n, s in ((0.0, 1.0), (6.0, 0.3), (6.0, 1.0))
    ]
    floors = [floor.astype(jnp.float32) for floor in floors]
    bare, faint, strong = (float(jnp.mean(jnp.abs(f - floors[0]))) for f in floors)
    assert bare == 0 and 0 < faint < 0.6 * strong
