from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.floors.render import LAMP_RADIANCE, Mirror
from ebjax.floors.scene import lamps
from ebjax.floors.sequence import CorridorConfig, check

from .test_render import FLAT, camera, corridor_of, pose, render

UPSIDE_DOWN = jnp.diag(jnp.array([1.0, 1.0, -1.0, 1.0]))


def mirror(strength, windows=0.0, rough=0.0):
    return Mirror(*map(jnp.asarray, (strength, windows, rough)))


@pytest.mark.parametrize("windows", [0.0, 5.0])
def test_the_floor_mirrors_what_a_camera_below_it_would_see(windows):
    """The image of the walls is what the camera sees from its place below the floor, times Fresnel's share."""
    dark = corridor_of(np.full((120, 500, 3), 1e-6))
    cam, at = camera(), pose(3.0, 0.2, 0.1)
    light = replace(FLAT, mirror=mirror(1.0, windows))
    seen, depth = map(np.asarray, render(dark, cam, at, light))
    below, far = map(np.asarray, render(dark, cam, UPSIDE_DOWN @ at, light))
    rays = np.linalg.inv(np.asarray(cam.intrinsics)) @ np.stack(
        [*np.meshgrid(np.arange(cam.width), np.arange(cam.height)), np.ones((cam.height, cam.width))]
    ).reshape(3, -1)
    rays = (np.asarray(at @ cam.base_from_camera)[:3, :3] @ rays).reshape(3, cam.height, cam.width)
    cosine = -rays[2] / np.linalg.norm(rays, axis=0)
    height = float((at @ cam.base_from_camera)[2, 3])
    floor = (np.abs(height + depth * rays[2]) < 1e-6) & (rays[2] < 0)
    wall = floor & (-height - far * rays[2] < 2.55)
    assert wall.sum() > 200
    share = (0.04 + 0.96 * (1 - cosine) ** 5)[..., None]
    # Edges of doors are softer than half a pixel in neither.
    np.testing.assert_allclose(seen[wall], (share * below)[wall], atol=2e-5)
    assert windows == 0 or seen[wall].max() > 0.3


def test_no_mirror_and_one_of_no_strength_are_the_same():
    floor = corridor_of(np.full((120, 500, 3), 0.4))
    cam, at = camera(), pose(3.0, 0.2, 0.1)
    for a, b in zip(
        render(floor, cam, at, FLAT), render(floor, cam, at, replace(FLAT, mirror=mirror(0.0))), strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_lamps_come_in_other_sizes():
    along, across = jnp.meshgrid(jnp.linspace(-2, 2, 401), jnp.linspace(-1, 1, 201))
    blur = jnp.full(along.shape, 1e-4)
    share = lamps(along, across, blur, jnp.array([1.0, 0.5, 0.2]))
    np.testing.assert_allclose(float(share.mean()), 0.5 * 0.1, atol=3e-3)
    assert LAMP_RADIANCE > 1


@pytest.mark.parametrize(
    ("changes", "key"),
    [({"mirror": 2.0}, "mirror"), ({"windows": 1.0}, "mirror is 0"), ({"lamp_m": (1.0, 0.0, 1.0)}, "lamp_m")],
)
def test_what_no_room_has_is_refused(changes, key):
    with pytest.raises(ValueError, match=key):
        check(CorridorConfig(**changes))
