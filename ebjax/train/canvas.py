"""Synthetic floors to learn from: grey squares of every family, made from a key, with wear and aliasing of all degrees.

What is seen of a canvas from direction d (a unit vector) is base + d . lean: only a pile has a lean (`floors.carpet`).
"""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ebjax.command import progress
from ebjax.floors.noise import fractal_noise
from ebjax.floors.surface import LEARNED as NAMES
from ebjax.floors.surface import FamilyName, Material, family
from ebjax.floors.wear import paint, scatter
from ebjax.io.atomic import whole_file
from ebjax.models.luma import luma

TEXEL_M = 0.005
SIDE_PX = 512
"""Of a canvas; its pixel is twice a texel wide, 1 cm, averaged from four."""
ZOOM = (0.5, 1.6)
"""The pattern's scale against the family's own: floors come in all sizes."""
DESIGNS = (1, 4, 24)
WEAR_PER_M2 = (0.3, 10.0)
DIRT, STRENGTH = (0.2, 2.0), (0.3, 1.0)
"""Of grime and of marks."""
MARKS_A_CALL = 64


@partial(jax.jit, static_argnames=("name", "designs"))
def _clean(name: FamilyName, designs: int, options: Float[Array, "6"], *, key: Key[Array, ""]) -> Float[Array, "H W C"]:
    """The floor under its grime; options are zoom, angle, disorder, dirt, and the place on the endless floor, m."""
    zoom, angle, disorder, dirt = (options[k] for k in range(4))
    own = family(name)
    material = Material(name, own.size_m, own.joint_m, designs, disorder, dirt, TEXEL_M)
    u, v = jnp.meshgrid(*((jnp.arange(2 * SIDE_PX, dtype=jnp.float32) + 0.5) * TEXEL_M,) * 2)
    c, s = jnp.cos(angle) * zoom, jnp.sin(angle) * zoom
    points = jnp.stack([c * u - s * v, s * u + c * v], -1) + options[None, None, 4:]
    floor_key, coarse, fine = jax.random.split(key, 3)
    colour = own.reflectance(points, material, key=floor_key)
    grime = fractal_noise(1.5 * points, key=coarse) + 0.5 * fractal_noise(5.0 * points, key=fine, octaves=3)
    return colour * (1 + 0.1 * dirt * grime)[..., None]


@jax.jit
def _seen(floor: Float[Array, "H W C"], angle: Float[Array, ""]) -> Float[Array, "h w 3"]:
    base = luma(jnp.clip(floor[..., :3], 0.01, 0.95))
    lean = jnp.zeros((*base.shape, 2), base.dtype) if floor.shape[-1] == 3 else floor[..., 3:]
    c, s = jnp.cos(angle), jnp.sin(angle)
    lean = jnp.stack([c * lean[..., 0] + s * lean[..., 1], c * lean[..., 1] - s * lean[..., 0]], -1)
    both = jnp.concatenate([base[..., None], base[..., None] * lean], -1)
    return both.reshape(SIDE_PX, 2, SIDE_PX, 2, 3).mean((1, 3))


def make_canvas(number: int, *, seed: int) -> Float[np.ndarray, "h w 3"]:
    """One canvas, float16: its base, and its lean along x and y; families take turns.

    Args:
      number: of the canvas.
      seed: of all of them.
    """
    rng = np.random.default_rng([seed, number])
    name = NAMES[number % len(NAMES)]
    designs = int(rng.choice(DESIGNS))
    zoom, wear = (float(np.exp(rng.uniform(*np.log(bounds)))) for bounds in (ZOOM, WEAR_PER_M2))
    angle = float(rng.uniform(0, 2 * np.pi))
    disorder = float(rng.choice([0.0, 1.0, rng.uniform()]))
    options = [zoom, angle, disorder, float(rng.uniform(*DIRT)), *rng.uniform(-30, 30, 2)]
    key = jax.random.fold_in(jax.random.key(seed), number)
    floor = _clean(name, designs, jnp.asarray(options, jnp.float32), key=key)

    side = 2 * SIDE_PX * TEXEL_M
    whole = np.zeros((1, 2)), np.array([[1.0, 0.0]]), np.full((1, 2), side)
    marks = scatter(lambda i, points: np.ones(len(points), bool), *whole, wear, family(name).marks, rng)
    strength = jnp.float32(rng.uniform(*STRENGTH))
    for order, (kind, found) in enumerate(marks.items()):
        for start in range(0, len(found.places), MARKS_A_CALL):
            which = np.arange(start, start + MARKS_A_CALL)
            some = which % len(found.places)
            floor = paint(
                floor,
                kind,
                jnp.asarray(found.places[some] / TEXEL_M - 0.5, jnp.float32),
                jnp.asarray(found.numbers[some], jnp.int32),
                jnp.asarray(which < len(found.places)),
                jnp.array([1.0, 0.0], jnp.float32),
                strength,
                TEXEL_M,
                key=jax.random.fold_in(key, order),
            )
    return np.asarray(_seen(floor, jnp.float32(angle)), np.float16)


def make_canvases(count: int, kept: Path, *, seed: int) -> Float[np.ndarray, "N h w 3"]:
    """The first canvases of a seed; those of an earlier run are read again.

    Args:
      count: how many.
      kept: the file in which they stay.
      seed: of all of them.
    """
    name = kept.with_name(f"{kept.stem}-{seed}-{count}{kept.suffix}")
    if name.is_file():
        return np.load(name)
    made = np.stack([make_canvas(k, seed=seed) for k in progress(range(count), count, "laying floors")])
    with whole_file(name, "wb") as file:
        np.save(file, made)
    return made
