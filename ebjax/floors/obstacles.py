"""Boxes and posts that stand in front of the floor: furniture, carts, shoes; table legs and people's legs.

Analytic, so that their depth is exact. World: z up, metres. Rays are lists of their three world components, not of unit
length: t is whatever the ray's parameter is.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ebjax.geometry.pytree import pytree

Plane = Float[Array, "H W"]


@pytree
class Boxes:
    """Upright boxes with horizontal bands of two colours."""

    centres: Float[Array, "B 2"]
    directions: Float[Array, "B 2"]
    """Unit vector of the first side."""
    halves: Float[Array, "B 2"]
    """Half the length of both sides, m; a box of size 0 is not there."""
    bottoms: Float[Array, " B"]
    tops: Float[Array, " B"]
    colours: Float[Array, "B 2 3"]
    bands_m: Float[Array, " B"]
    """Height of a pair of bands, m."""


@pytree
class Posts:
    """Upright round posts without caps."""

    centres: Float[Array, "P 2"]
    radii: Float[Array, " P"]
    bottoms: Float[Array, " P"]
    tops: Float[Array, " P"]
    colours: Float[Array, "P 3"]


def no_boxes(dtype: DTypeLike = jnp.float32) -> Boxes:
    """Nothing."""
    return Boxes(*(jnp.asarray(np.zeros(s, dtype)) for s in ((0, 2), (0, 2), (0, 2), (0,), (0,), (0, 2, 3), (0,))))


def no_posts(dtype: DTypeLike = jnp.float32) -> Posts:
    """Nothing."""
    return Posts(*(jnp.asarray(np.zeros(s, dtype)) for s in ((0, 2), (0,), (0,), (0,), (0, 3))))


def _safe(x):
    return jnp.where(jnp.abs(x) < 1e-9, 1e-9, x)


def see_boxes(
    boxes: Boxes, ray: list[Plane], origin: Float[Array, "3 *rows"], nearest: Plane, colour: Float[Array, "H W 3"]
) -> tuple[Plane, Float[Array, "H W 3"]]:
    """The nearer one of what was seen and the boxes: t, and reflectance with faces shaded by their side."""

    def step(seen, box):
        t_before, before = seen
        c, s = box.directions[0], box.directions[1]
        dx, dy = origin[0] - box.centres[0], origin[1] - box.centres[1]
        start = [c * dx + s * dy, c * dy - s * dx, origin[2] - (box.bottoms + box.tops) / 2]
        slope = [_safe(c * ray[0] + s * ray[1]), _safe(c * ray[1] - s * ray[0]), _safe(ray[2])]
        sizes = [box.halves[0], box.halves[1], (box.tops - box.bottoms) / 2]
        ins = [(-jnp.sign(m) * h - o) / m for m, h, o in zip(slope, sizes, start, strict=True)]
        outs = [(jnp.sign(m) * h - o) / m for m, h, o in zip(slope, sizes, start, strict=True)]
        t_in = jnp.maximum(jnp.maximum(ins[0], ins[1]), ins[2])
        t_out = jnp.minimum(jnp.minimum(outs[0], outs[1]), outs[2])
        hit = (t_in < t_out) & (t_in > 0) & (t_in < t_before)
        height = origin[2] + jnp.where(hit, t_in, 0.0) * ray[2] - box.bottoms
        on_top = ins[2] >= t_in
        upper = (height / box.bands_m) % 1.0 > 0.5
        own = jnp.where((upper | on_top)[..., None], box.colours[0][None, None, :], box.colours[1][None, None, :])
        shade = jnp.where(on_top, 1.0, jnp.where(ins[0] >= t_in, 0.85, 0.7))
        return (jnp.where(hit, t_in, t_before), jnp.where(hit[..., None], own * shade[..., None], before)), None

    return jax.lax.scan(step, (nearest, colour), boxes)[0]


def see_posts(
    posts: Posts, ray: list[Plane], origin: Float[Array, "3 *rows"], nearest: Plane, colour: Float[Array, "H W 3"]
) -> tuple[Plane, Float[Array, "H W 3"]]:
    """The nearer one of what was seen and the posts: t, and reflectance that falls off towards their outlines."""

    def step(seen, post):
        t_before, before = seen
        dx, dy = origin[0] - post.centres[0], origin[1] - post.centres[1]
        a = ray[0] ** 2 + ray[1] ** 2
        b = dx * ray[0] + dy * ray[1]
        inside = b**2 - a * (dx**2 + dy**2 - post.radii**2)
        root = jnp.sqrt(jnp.where(inside > 0, inside, 1.0))
        t = (-b - root) / a
        z = origin[2] + t * ray[2]
        hit = (inside > 0) & (t > 0) & (t < t_before) & (z > post.bottoms) & (z < post.tops)
        # The normal's share of the ray: 1 in the middle of the post, 0 at its outline.
        facing = jnp.clip(root / (jnp.sqrt(a) * jnp.maximum(post.radii, 1e-6)), 0, 1)
        own = post.colours[None, None, :] * (0.45 + 0.55 * facing)[..., None]
        return (jnp.where(hit, t, t_before), jnp.where(hit[..., None], own, before)), None

    return jax.lax.scan(step, (nearest, colour), posts)[0]


def shade_by_boxes(boxes: Boxes, x: Plane, y: Plane) -> Plane:
    """Darkening of the floor under and close to boxes, less the higher they hang."""

    def step(shade, box):
        c, s = box.directions[0], box.directions[1]
        dx, dy = x - box.centres[0], y - box.centres[1]
        u, v = jnp.abs(c * dx + s * dy) - box.halves[0], jnp.abs(c * dy - s * dx) - box.halves[1]
        depth = 0.55 * (box.halves[0] > 0) * jnp.exp(-jnp.maximum(box.bottoms, 0.0) / 0.15)
        return shade * (1 - depth * jnp.exp(-jnp.maximum(jnp.maximum(u, v), 0.0) / 0.1)), None

    return jax.lax.scan(step, jnp.ones_like(x), boxes)[0]


def shade_by_posts(posts: Posts, x: Plane, y: Plane) -> Plane:
    """Darkening of the floor around posts."""

    def step(shade, post):
        squared = (x - post.centres[0]) ** 2 + (y - post.centres[1]) ** 2 - post.radii**2
        depth = 0.4 * (post.radii > 0) * jnp.exp(-jnp.maximum(post.bottoms, 0.0) / 0.15)
        return shade * (1 - depth * jnp.exp(-jnp.maximum(squared, 0.0) / 0.12**2)), None

    return jax.lax.scan(step, jnp.ones_like(x), posts)[0]
