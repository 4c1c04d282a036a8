import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.train.mirror import Room, draw_room, mirrored
from ebjax.train.photograph import Wild
from ebjax.train.views import _draw_floor, _reflection, sample_pairs

from .test_views import canvas  # noqa: F401

DARK = Room(
    ceiling_m=3.0,
    walls_m=(50.0, 50.0),
    end_m=100.0,
    wall=0.0,
    doors=(3.0, 1.0, 0.0),
    windows=(3.0, 1.0, 0.5, 0.0),
    lamps=(100.0, 0.2, 0.2, 0.0, 10.0),
    far=(1.0, 0.0),
    rough=1e-4,
    polish=1.0,
)
HEIGHT_M = 0.6


def image(room, along_m=0.0, heading=0.0):
    x, y = jnp.meshgrid(jnp.linspace(-1, 1, 81, dtype=jnp.float32), jnp.linspace(0.2, 2.2, 161, dtype=jnp.float32))
    room = Room(**{f.name: jnp.asarray(getattr(room, f.name), jnp.float32) for f in dataclasses.fields(room)})
    parts = (jnp.asarray(value, jnp.float32) for value in (HEIGHT_M, heading, along_m))
    return np.asarray(jax.jit(mirrored)(room, (x, y), *parts)), np.asarray(x), np.asarray(y)


def test_a_lamp_is_mirrored_where_its_angles_are_equal():
    """A lamp 6 m ahead: h / y = H / (6 - y) where the camera is h high and the lamp H."""
    found, x, y = image(DARK, along_m=-6.0)
    row, column = np.unravel_index(np.argmax(found), found.shape)
    expected = 6.0 * HEIGHT_M / (HEIGHT_M + DARK.ceiling_m)
    assert abs(x[row, column]) < 0.1 and abs(y[row, column] - expected) < 0.05
    cosine = HEIGHT_M / np.hypot(HEIGHT_M, expected)
    share = 0.04 + 0.96 * (1 - cosine) ** 5
    np.testing.assert_allclose(found.max(), share * 10.5, rtol=0.1)


def test_it_stands_where_the_camera_stands():
    near, _, y = image(DARK, along_m=-4.0)
    far, _, _ = image(DARK, along_m=-6.0)
    at = [y[np.unravel_index(np.argmax(found), found.shape)] for found in (near, far)]
    np.testing.assert_allclose(at[1] - at[0], 2.0 * HEIGHT_M / (HEIGHT_M + DARK.ceiling_m), atol=0.05)


def test_a_floor_without_polish_mirrors_nothing():
    assert not image(dataclasses.replace(DARK, polish=0.0))[0].any()
    polished = [float(draw_room(0.3, key=jax.random.key(k)).polish) for k in range(200)]
    assert 0.2 < np.mean(np.array(polished) > 0) < 0.4 and max(polished) <= 1 and min(polished) == 0


def test_rooms_are_finite_from_everywhere():
    for k in range(30):
        room = draw_room(1.0, key=jax.random.key(k))
        found, _, _ = image(room, along_m=float(k), heading=0.05 * (k - 15))
        assert np.isfinite(found).all() and found.min() >= 0


@pytest.mark.slow
def test_wild_views_are_harder_and_in_range(canvas):  # noqa: F811
    tame, wild = (sample_pairs(canvas, 6, 96, w, key=jax.random.key(0)) for w in (Wild(), Wild(1.0, 1.0)))
    np.testing.assert_allclose(tame.second_from_first, wild.second_from_first, rtol=1e-5, atol=1e-7)
    for views in (wild.first, wild.second):
        assert bool(jnp.isfinite(views).all()) and float(views.min()) >= 0 and float(views.max()) <= 1
    assert float(jnp.abs(tame.first - wild.first).mean()) > 0.02


def test_half_of_the_floors_mirror_the_same_at_every_place():
    differ = []
    for k in range(24):
        floor = _draw_floor(Wild(1.0, 0.0), key=jax.random.key(k))
        images = [_reflection(floor, 64, way, key=jax.random.key(n + 2 * way)) for way in (0, 1) for n in range(2)]
        assert float(jnp.abs(images[0] - images[2]).max()) > 0, "the ways differ"
        differ.append(float(jnp.abs(images[0] - images[1]).mean()) / float(images[0].mean()))
    assert sum(one < 0.2 for one in differ) >= 6 and sum(one > 0.2 for one in differ) >= 6
