"""A floor view in harsh light, unsteady and noisy: what retrieval has to stand, and may be trained on.

The floor is turned and scaled about the view's centre and smeared along a line; then comes tone, a hard shadow, a
saturated spot and noise. `strength` scales all of it at once, 0 changes nothing. The camera keeps its field of view:
what leaves it is lost, and what comes in from beyond it is not seen.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from ebjax.geometry.homography import Scalar
from ebjax.geometry.warp import sample_bilinear

ROTATION_DEG, SCALE = 6.0, 0.07
BLUR = 0.035
"""Longest smear, as a share of the view's longer side: 7 of 200 px."""
BLUR_TAPS = 9
GAMMA = (0.5, 1.8)
SHADOW = (0.45, 0.85)
"""Light that a shadow leaves."""
SPOT = 1.0
"""Light in the middle of the spot; 1 saturates."""
SPOT_WIDTH = (0.03, 0.08)
"""Standard deviation of the spot, as a share of the longer side."""
NOISE = 0.01


@jax.jit
def corrupt(
    view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], strength: Scalar = 1.0, *, key: Key[Array, ""]
) -> tuple[Float[Array, "H W 3"], Bool[Array, "H W"]]:
    """View and field of view after all corruptions, each drawn at random up to its limit times `strength`.

    Args:
      view: RGB in [0, 1].
      seen: what of it is floor.
      strength: 0 gives back the view.
      key: of everything random.
    """
    strength = jnp.asarray(strength, view.dtype)
    draw_key, noise_key = jax.random.split(key)
    # One draw for all: every call of a random function takes a second to compile.
    drawn = jax.random.uniform(draw_key, (11,), view.dtype)
    moved, still_seen = _moved(view, seen, strength, drawn[:4])
    lit = _lit(moved, strength, drawn[4:])
    noise = NOISE * strength * jax.random.normal(noise_key, view.shape, view.dtype)
    return jnp.clip(lit + noise, 0, 1), still_seen


def _grid(size: tuple[int, ...], dtype) -> Float[Array, "H W 2"]:
    """(x, y) from the view's centre, px."""
    rows, columns = (jnp.arange(length, dtype=dtype) - (length - 1) / 2 for length in size[:2])
    return jnp.stack(jnp.broadcast_arrays(columns[None, :], rows[:, None]), -1)


def _moved(view, seen, strength, drawn):
    """Rotation, scale, and the mean along a line; a pixel is seen where all it was averaged from was."""
    dtype, size = view.dtype, view.shape[:2]
    turn, stretch, way, length = drawn
    angle = jnp.radians(ROTATION_DEG) * strength * (2 * turn - 1)
    scale = 1 + SCALE * strength * (2 * stretch - 1)
    c, s = jnp.cos(angle) * scale, jnp.sin(angle) * scale
    line = BLUR * strength * max(size) * length * jnp.stack([jnp.cos(jnp.pi * way), jnp.sin(jnp.pi * way)])
    centre = jnp.array([(size[1] - 1) / 2, (size[0] - 1) / 2], dtype)
    points = _grid(size, dtype) @ jnp.array([[c, s], [-s, c]]) + centre[None, None, :]
    layers = jnp.concatenate([view, seen[..., None].astype(dtype)], -1)

    def add(total, share):
        return total + sample_bilinear(layers, points + share * line[None, None, :]), None

    total, _ = jax.lax.scan(add, jnp.zeros_like(layers), jnp.linspace(-0.5, 0.5, BLUR_TAPS, dtype=dtype))
    mean = total / BLUR_TAPS
    return mean[..., :3], seen & (mean[..., 3] > 0.99)


def _lit(view, strength, drawn):
    """Gamma, a half plane in shadow with an edge one pixel wide, a spot of glare."""
    side, from_centre = max(view.shape[:2]), _grid(view.shape, view.dtype)
    tone, way, offset, left, x, y, width = drawn
    logarithm = _between(jnp.log(jnp.asarray(GAMMA, view.dtype)), tone)
    toned = jnp.maximum(view, 1e-6) ** jnp.exp(strength * logarithm)
    normal = jnp.stack([jnp.cos(2 * jnp.pi * way), jnp.sin(2 * jnp.pi * way)])
    edge = from_centre @ normal - 0.8 * side * (offset - 0.5)
    dark = strength * (1 - _between(SHADOW, left))
    shaded = toned * jnp.clip(1 - dark * jnp.clip(edge + 0.5, 0, 1), 0, 1)[..., None]
    at = jnp.stack([view.shape[1] * (x - 0.5), view.shape[0] * (y - 0.5)])
    squared = jnp.sum((from_centre - at[None, None, :]) ** 2, -1)
    spot = jnp.exp(-squared / (2 * (side * _between(SPOT_WIDTH, width)) ** 2))
    return shaded + SPOT * strength * spot[..., None]


def _between(limits, share):
    return limits[0] + (limits[1] - limits[0]) * share
