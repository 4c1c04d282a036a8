from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.surface import FAMILIES, FloorConfig, check, family, joint, lay, material

AXIS = jnp.arange(0.0, 3.0, 0.05).astype(jnp.float32)
POINTS = jnp.stack(jnp.meshgrid(AXIS, AXIS), axis=-1)


def config_of(name):
    texture = Path("photo.jpg") if name == "photograph" else None
    return material(FloorConfig(family=name, texture=texture))


def reflectance_of(name):
    config = config_of(name)
    photographs = jnp.asarray(np.random.default_rng(0).uniform(0.1, 0.9, (3, 16, 16, 3)).astype(np.float32))
    extra = (photographs,) if name == "photograph" else ()
    return jax.jit(lambda points, key: family(name).reflectance(points, config, *extra, key=key))


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_is_a_function_of_its_key(name):
    of = reflectance_of(name)
    floor = of(POINTS, jax.random.key(3))
    assert floor.shape == (*POINTS.shape[:2], 5 if name == "carpet" else 3) and floor.dtype == jnp.float32
    assert jnp.all(jnp.isfinite(floor)) and floor[..., :3].min() > -0.1 and floor[..., :3].max() < 1.2
    assert floor.std() > 0.005 and 0.02 < floor[..., :3].mean() < 0.8
    assert jnp.all(floor == of(POINTS, jax.random.key(3)))
    assert jnp.mean(jnp.abs(floor - of(POINTS, jax.random.key(4)))) > 1e-3
    marks = family(name).marks
    assert 0 < sum(marks.values()) <= 1 + 1e-9


def test_without_disorder_and_dirt_tiles_of_one_design_are_equal():
    floor = config_of("photograph")._replace(disorder=0.0, dirt=0.0, designs=2)
    cuts = jnp.asarray(np.random.default_rng(0).uniform(0.1, 0.9, (2, 16, 16, 3)).astype(np.float32))
    of = jax.jit(lambda points: family("photograph").reflectance(points, floor, cuts, key=jax.random.key(1)))
    east = jnp.array([[[0.6, 0.0]]], jnp.float32)
    here, one_on, two_on = (of(POINTS + 0.01 + n * east) for n in range(3))
    # Float32 rounds points differently a tile further on: not bit for bit, and not at a joint's very edge.
    assert jnp.quantile(jnp.abs(two_on - here), 0.99) < 1e-3
    assert jnp.quantile(jnp.abs(one_on - here), 0.99) > 0.05


@pytest.mark.parametrize("bond, turns", [(0.0, 4), (0.5, 2), (None, 1)])
def test_elements_cover_the_floor_and_keep_to_their_size(bond, turns):
    points = jnp.asarray(np.random.default_rng(0).uniform(-3, 3, (2000, 2)))
    config = config_of("slabs")._replace(disorder=1.0)
    size = (0.6, 0.6) if turns == 4 else (0.9, 0.3)
    found = jax.jit(lambda p: lay(p, size, config, key=jax.random.key(0), bond=bond, turns=turns))(points)
    assert jnp.all(found.edge_m >= 0) and found.edge_m.max() <= min(size) / 2
    assert jnp.all(jnp.abs(found.local) <= jnp.array(size)[None, :] / 2 + 1e-9)
    windows = jnp.round(found.pattern - found.local, 6)
    assert len(jnp.unique(windows, axis=0)) == config.designs


def test_thin_joints_cover_their_share():
    edges = jnp.abs(jnp.linspace(-0.1, 0.1, 20001))
    for width in (0.001, 0.006):
        assert float(jnp.mean(joint(edges, width, 0.003))) * 0.2 == pytest.approx(width, rel=0.01)
    assert joint(edges, 0.001, 0.003).max() == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    "key, value",
    [
        ("size_m", -1.0),
        ("joint_m", 0.9),
        ("disorder", 1.5),
        ("wear_per_m2", -1.0),
        ("designs", 0),
        ("texture", Path("photo.jpg")),
    ],
)
def test_bad_values_name_their_key(key, value):
    with pytest.raises(ValueError, match=f"floor.{key} is"):
        check(replace(FloorConfig(), **{key: value}))


def test_photographs_need_a_file():
    with pytest.raises(ValueError, match=r"floor\.texture is None"):
        check(FloorConfig(family="photograph"))
