"""What floornet is taught: opposing views of one place correlate best, and points find themselves.

All are InfoNCE (van den Oord et al. 2018): the cross-entropy of a softmax over similarities / temperature, both ways.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from ebjax.geometry.homography import apply
from ebjax.geometry.warp import sample_bilinear
from ebjax.models.floornet import CELL, parity
from ebjax.models.layers import normalise
from ebjax.places.correlation import MIN_OVERLAP, OVERLAP_POWER

SAFE_PX = 4.5
"""Points of one view this close to each other are no negatives."""
MARGIN_PX = 8


def cross_entropy(
    similarity: Float[Array, "*n K K"], allowed: Bool[Array, "*n K K"], valid: Bool[Array, "*n K"]
) -> Float[Array, ""]:
    """Mean -log softmax of the diagonal, over rows and over columns, of the rows that are valid.

    Args:
      similarity: over temperature.
      allowed: which entries are negatives; the diagonal always counts.
      valid: rows and columns that take part.
    """
    count = similarity.shape[-1]
    same = jnp.broadcast_to(jnp.eye(count, dtype=bool), similarity.shape)
    present = (allowed & valid[..., None, :] & valid[..., :, None]) | same
    logits = jnp.where(present, similarity, -1e9)
    diagonal = jnp.diagonal(similarity, axis1=-2, axis2=-1)
    losses = (jax.nn.logsumexp(logits, -1) + jax.nn.logsumexp(logits, -2)) / 2 - diagonal
    return jnp.sum(losses * valid) / jnp.maximum(jnp.sum(valid), 1)


def first_is_best(similarity: Float[Array, "N N"]) -> Float[Array, ""]:
    """The share of rows whose diagonal entry is the largest: recall at 1."""
    return jnp.mean(jnp.argmax(similarity, 1) == jnp.arange(len(similarity)))


def without_common(
    first: Float[Array, "N h w D"],
    second: Float[Array, "N h w D"],
    masks: tuple[Float[Array, "h w"], Float[Array, "h w"]],
    floors: int,
) -> tuple[Float[Array, "N h w D"], Float[Array, "N h w D"]]:
    """Takes away what all views of a floor have in common, in the robot's own frame, and masks.

    Args:
      first: maps, floor by floor.
      second: of the facing views, unturned: in a robot's frame their odd channels have the other sign.
      masks: cells that count in each.
      floors: how many.
    """
    sign = jnp.asarray(parity(first.shape[-1]), first.dtype)
    weights = [mask[None, ..., None] for mask in masks]
    a, b = (values.reshape(floors, -1, *values.shape[1:]) for values in (first, second))
    total = jnp.sum(a * weights[0][None], (1, 2, 3)) + sign[None, :] * jnp.sum(b * weights[1][None], (1, 2, 3))
    mean = total / jnp.maximum(a.shape[1] * (masks[0].sum() + masks[1].sum()), 1)
    mean = jnp.repeat(mean, a.shape[1], axis=0)[:, None, None, :]
    return (first - mean) * weights[0], (second - mean * sign[None, None, None, :]) * weights[1]


def correlations(
    first: Float[Array, "N h w D"],
    second: Float[Array, "N h w D"],
    masks: tuple[Float[Array, "h w"], Float[Array, "h w"]],
) -> Float[Array, "N N"]:
    """Shift-maximised correlation of every first view with every second one: `places.correlation`, for training."""
    height, width = first.shape[1:3]
    size = 2 * height, 2 * width

    def transformed(values):
        return jnp.fft.rfft2(values, size, axes=(1, 2))

    def shifts(spectrum):
        return jnp.fft.irfft2(spectrum, size, axes=(-2, -1))

    a, b = (transformed(values).reshape(len(values), -1, values.shape[-1]) for values in (first, second))
    real = jnp.einsum("nfd,mfd->fnm", a.real, b.real) + jnp.einsum("nfd,mfd->fnm", a.imag, b.imag)
    imaginary = jnp.einsum("nfd,mfd->fnm", a.imag, b.real) - jnp.einsum("nfd,mfd->fnm", a.real, b.imag)
    product = jax.lax.complex(real, imaginary).transpose(1, 2, 0)
    raw = shifts(product.reshape(*product.shape[:2], size[0], -1))

    counts = [transformed(mask[None, ..., None])[0, ..., 0] for mask in masks]
    energy = [transformed(jnp.sum(v**2, -1, keepdims=True))[..., 0] for v in (first, second)]
    of_first = shifts(energy[0] * jnp.conj(counts[1])[None])
    of_second = shifts(counts[0][None] * jnp.conj(energy[1]))
    overlap = shifts(counts[0] * jnp.conj(counts[1])) / jnp.maximum(masks[0].sum(), 1)
    weight = jnp.where(overlap > MIN_OVERLAP, jnp.maximum(overlap, 1e-6) ** OVERLAP_POWER, 0)[None, None]
    scale = jnp.maximum(of_first, 1e-6)[:, None] * jnp.maximum(of_second, 1e-6)[None]
    score = jnp.where(weight > 0, raw * jax.lax.rsqrt(scale) * weight, -1)
    return jnp.max(score, axis=(-2, -1))


def choose_points(
    grey: Float[Array, "N S S"], seen: Float[Array, "S S"], count: int, *, key: Key[Array, ""]
) -> Float[Array, "N K 2"]:
    """Random pixels (x, y) of each view, the likelier the steeper the picture is there."""
    side = grey.shape[-1]
    gy = jnp.abs(grey[:, 2:, 1:-1] - grey[:, :-2, 1:-1])
    gx = jnp.abs(grey[:, 1:-1, 2:] - grey[:, 1:-1, :-2])
    steep = jnp.pad(gx + gy, ((0, 0), (1, 1), (1, 1)))
    ticks = jnp.arange(side)
    inner = (ticks >= MARGIN_PX) & (ticks < side - MARGIN_PX)
    allowed = (seen > 0) & inner[:, None] & inner[None, :]
    logits = jnp.where(allowed[None], jnp.log(steep + 0.02), -jnp.inf).reshape(len(grey), -1)
    _, index = jax.lax.top_k(logits + jax.random.gumbel(key, logits.shape, logits.dtype), count)
    return jnp.stack([index % side, index // side], -1).astype(grey.dtype)


def correspondences(
    points: Float[Array, "N K 2"], second_from_first: Float[Array, "N 3 3"], seen: Float[Array, "S S"]
) -> tuple[Float[Array, "N K 2"], Bool[Array, "N K"]]:
    """Where points of the first views lie in the second ones, and whether they are seen there."""
    found = jax.vmap(apply)(second_from_first, points)
    inside = (found >= MARGIN_PX) & (found <= seen.shape[0] - 1 - MARGIN_PX)
    return found, inside.all(-1) & (sample_bilinear(seen[..., None], found)[..., 0] > 0.99)


def read(maps: Float[Array, "N h w D"], points: Float[Array, "N K 2"], stride: int) -> Float[Array, "N K D"]:
    """Bilinear reads at pixels (x, y) of maps of a stride, made unit."""
    return normalise(jax.vmap(sample_bilinear)(maps, (points + 0.5) / stride - 0.5))


def dense_loss(
    first: Float[Array, "N h w D"],
    second: Float[Array, "N h w D"],
    points: tuple[Float[Array, "N K 2"], Float[Array, "N K 2"]],
    valid: Bool[Array, "N K"],
    temperature: float,
) -> Float[Array, ""]:
    """Points of all views against each other; those of the same view lie a cell and a half apart, or do not count."""
    a, b = (read(maps, at, CELL).reshape(-1, first.shape[-1]) for maps, at in zip((first, second), points, strict=True))
    views = jnp.repeat(jnp.arange(len(first)), points[0].shape[1])
    flat = points[0].reshape(-1, 2)
    apart = jnp.sum((flat[:, None] - flat[None]) ** 2, -1) > (1.5 * CELL) ** 2
    return cross_entropy(a @ b.T / temperature, (views[:, None] != views[None, :]) | apart, valid.reshape(-1))


def local_loss(
    first: Float[Array, "N h w D"],
    second: Float[Array, "N h w D"],
    scores: tuple[Float[Array, "N h w"], Float[Array, "N h w"]],
    points: tuple[Float[Array, "N K 2"], Float[Array, "N K 2"]],
    valid: Bool[Array, "N K"],
    temperature: float,
) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
    """Points of one view among those of the other; how well the scores tell right matches; the share of right ones."""
    a, b = (read(maps, at, CELL // 2) for maps, at in zip((first, second), points, strict=True))
    apart = jnp.sum((points[0][:, :, None] - points[0][:, None]) ** 2, -1) > SAFE_PX**2
    similarity = jnp.einsum("nkd,nld->nkl", a, b)
    loss = cross_entropy(similarity / temperature, apart, valid)
    same = jnp.eye(similarity.shape[-1], dtype=bool)[None]
    rivals = jnp.where((apart | same) & valid[:, None, :], similarity, -2)
    right = (jnp.argmax(rivals, 2) == jnp.arange(similarity.shape[-1])[None, :]).astype(a.dtype)
    logits = [
        jax.vmap(sample_bilinear)(score[..., None], (at + 0.5) / (CELL // 2) - 0.5)[..., 0]
        for score, at in zip(scores, points, strict=True)
    ]
    wrong = [jax.nn.softplus(jnp.where(right > 0, -logit, logit)) for logit in logits]
    count = jnp.maximum(valid.sum(), 1)
    return loss, jnp.sum((wrong[0] + wrong[1]) * valid) / (2 * count), jnp.sum(right * valid) / count
