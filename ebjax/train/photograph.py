"""What a camera makes of the floor before it, drawn from a key: light, lens, sensor and file; wet and dusty areas."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

GAMMA, GAIN = (0.5, 1.8), (0.6, 1.5)
SHADOW, SHADOW_EDGE_PX = (0.25, 0.9), (0.5, 20.0)
GLARE, GLARE_SIDE = (0.1, 1.2), (0.04, 0.25)
BLUR_PX, FAR_BLUR_PX = (0.2, 2.2), (0.3, 3.0)
NOISE, ROW_NOISE = (0.002, 0.03), (0.0003, 0.006)
"""Of pixels and of whole rows, as those of a rolling shutter under lamps."""
PATCH_SHARE, HIDDEN_SHARE, JPEG_SHARE = 0.3, 0.2, 0.6
"""Of views with a wet or dusty area, with one that was painted over, and of such as were kept as JPEG."""
JPEG_STEP = (0.2, 1.2)
"""Times JPEG_TABLE: qualities of about 90 to 40."""
JPEG_TABLE = 16.0 + 12.0 * np.add.outer(np.arange(8), np.arange(8))
"""Rises as the table of ITU-T T.81, annex K, does: steps of 16 to 184 of 255."""


@dataclasses.dataclass(frozen=True)
class Wild:
    """How often the views are as hard as real floors; 0 is none of it."""

    mirrors: float = 0.0
    """Share of floors that mirror the room."""
    rest: float = 0.0
    """Share, of the shares that are set, of pale floors, wet, dusty and painted over areas, JPEG and noise of rows."""


TAME = Wild()


def uniform(key: Key[Array, ""], bounds: tuple[float, float], shape: tuple[int, ...] = ()) -> Float[Array, "*s"]:
    """Numbers within bounds."""
    return jax.random.uniform(key, shape, jnp.float32, *bounds)


def around(key: Key[Array, ""], most: float, shape: tuple[int, ...] = ()) -> Float[Array, "*s"]:
    """Numbers within `most` of 0."""
    return uniform(key, (-most, most), shape)


def _blur_matrix(side: int, sigma: Float[Array, ""]) -> Float[Array, "S S"]:
    offset = jnp.arange(side, dtype=jnp.float32)
    kernel = jnp.exp(-0.5 * ((offset[:, None] - offset[None, :]) / sigma) ** 2)
    return kernel / kernel.sum(1, keepdims=True)


def patched(linear: Float[Array, "S S"], share: float, *, key: Key[Array, ""]) -> Float[Array, "S S"]:
    """Wet areas, dark, or dusty ones, paler and fainter, with soft ragged edges."""
    draw = jax.random.uniform(key, (15,), jnp.float32)
    ticks = (jnp.arange(len(linear), dtype=jnp.float32) + 0.5) / len(linear) - 0.5
    frequency, phase = 14 * (draw[:8].reshape(2, 4) - 0.5), 2 * jnp.pi * draw[8:12]
    down, across = (2 * jnp.pi * jnp.outer(one, ticks) for one in frequency)
    waves = down[:, :, None] + across[:, None, :] + phase[:, None, None]
    area = jax.nn.sigmoid((jnp.cos(waves).mean(0) - 0.25) / (0.02 + 0.2 * draw[12]))
    mean = linear.mean()
    changed = jnp.where(draw[13] < 0.5, linear * 0.6, 0.7 * linear + 0.3 * 1.2 * mean)
    return jnp.where(draw[14] < share, linear + area * (changed - linear), linear)


def _painted_over(value: Float[Array, "S S"], share: float, *, key: Key[Array, ""]) -> Float[Array, "S S"]:
    """A rectangle of one tone, where something stood."""
    draw = jax.random.uniform(key, (6,), jnp.float32)
    ticks = (jnp.arange(len(value), dtype=jnp.float32) + 0.5) / len(value)
    down, across = (jnp.abs(ticks - draw[k]) < 0.05 + 0.15 * draw[2 + k] for k in (0, 1))
    inside = down[:, None] & across[None, :]
    tone = value.mean() * (0.7 + 0.6 * draw[5])
    return jnp.where(inside & (draw[4] < share), tone, value)


def _as_jpeg(value: Float[Array, "S S"], share: float, *, key: Key[Array, ""]) -> Float[Array, "S S"]:
    """Rounds the cosine transform of blocks of 8 pixels."""
    draw = jax.random.uniform(key, (2,), jnp.float32)
    k = np.arange(8)
    cosines = np.cos(np.pi * np.outer(k, 2 * k + 1) / 16) * np.where(k == 0, 0.125, 0.25)[:, None] ** 0.5
    basis = jnp.asarray(cosines, jnp.float32)
    cells = len(value) // 8
    blocks = value.reshape(cells, 8, cells, 8)
    step = jnp.asarray(JPEG_TABLE / 255, jnp.float32) * jnp.exp(
        float(np.log(JPEG_STEP[0])) + float(np.log(JPEG_STEP[1] / JPEG_STEP[0])) * draw[0]
    )
    found = jnp.einsum("ku,aubv,lv->akbl", basis, blocks, basis)
    kept = jnp.round(found / step[None, :, None, :]) * step[None, :, None, :]
    back = jnp.einsum("ku,akbl,lv->aubv", basis, kept, basis).reshape(value.shape)
    return jnp.where(draw[1] < share, back, value)


def photograph(
    linear: Float[Array, "S S"],
    nearness: Float[Array, " S"],
    reflection: Float[Array, "S S"],
    wild: Wild,
    *,
    key: Key[Array, ""],
) -> Float[Array, "S S"]:
    """Light, lens and sensor: shadow, glare, blur that grows with distance, exposure, gamma, noise, eight bits.

    Args:
      linear: reflectance.
      nearness: of each row, 1 at the robot's feet, 0 at the far end.
      reflection: radiance that the floor mirrors.
      wild: how often there is what real floors have.
      key: of everything random.
    """
    side = len(nearness)
    keys = iter(jax.random.split(key, 20))
    wild_keys = iter(jax.random.split(jax.random.fold_in(key, 1), 4))
    ticks = (jnp.arange(side, dtype=jnp.float32) + 0.5) / side - 0.5
    y, x = ticks[:, None], ticks[None, :]

    def across() -> Float[Array, "S S"]:
        way = uniform(next(keys), (0.0, 2 * np.pi))
        return jnp.cos(way) * x + jnp.sin(way) * y

    edge_px = jnp.exp(uniform(next(keys), tuple(np.log(SHADOW_EDGE_PX))))
    covered = jax.nn.sigmoid((across() - around(next(keys), 0.5)) * side / edge_px)
    depth = jnp.where(uniform(next(keys), (0.0, 1.0)) < 0.6, 1 - uniform(next(keys), SHADOW), 0)
    light = (1 - depth * covered) * jnp.exp(across() * around(next(keys), 0.8))
    spot, size = around(next(keys), 0.5, (2,)), uniform(next(keys), GLARE_SIDE, (2,))
    glare = jnp.exp(-(((x - spot[0]) / size[0]) ** 2) / 2 - ((y - spot[1]) / (2 * size[1])) ** 2 / 2)
    shine = jnp.where(uniform(next(keys), (0.0, 1.0)) < 0.5, uniform(next(keys), GLARE), 0)
    gain = uniform(next(keys), GAIN)
    value = linear * light * gain / jnp.maximum(jnp.mean(linear), 0.02) * 0.35
    value = value + shine * glare + gain * reflection
    value = _painted_over(value, wild.rest * HIDDEN_SHARE, key=next(wild_keys))

    def blurred(values, sigma):
        return _blur_matrix(side, sigma[0]) @ values @ _blur_matrix(side, sigma[1]).T

    near = blurred(value, uniform(next(keys), BLUR_PX, (2,)))
    far = blurred(value, uniform(next(keys), FAR_BLUR_PX, (2,)))
    value = far + (near - far) * nearness[:, None]
    value = jnp.clip(value, 0, 1) ** (uniform(next(keys), GAMMA) / 2)
    noise = jnp.exp(uniform(next(keys), tuple(np.log(NOISE))))
    value = value + noise * jax.random.normal(next(keys), value.shape, value.dtype)
    rows = jnp.exp(uniform(next(wild_keys), tuple(np.log(ROW_NOISE)))) * (wild.rest > 0)
    value = value + rows * jax.random.normal(next(wild_keys), (side, 1), value.dtype)
    value = _as_jpeg(jnp.clip(value, 0, 1), wild.rest * JPEG_SHARE, key=next(wild_keys))
    return jnp.round(255 * jnp.clip(value, 0, 1)) / 255
