"""Floor and whole image in one vector, for carpets and other floors that say little (future work in Early Bird).

The floor is described as by `floornet`, the image as by `rootsift_vlad`, each with words of its own, and joined as
(sqrt(a) floor, sqrt(1 - a) whole), so that the cosine of two views is a times that of their floors plus 1 - a times
that of their images. The share a is learned from the run: a part counts by how far the best match of a view stands out
from the others beyond what chance would give (`distinctness`), and by how often the next view's best match is next to
it (`steadiness`), so one that tells nothing gets next to nothing.
From the opposite side only the floor is the same: of a view turned by pi the whole image has no part. The floor's maps
are correlated too, and count as much as its vector.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, UInt8

from ebjax.models.fast import Arithmetic
from ebjax.places import floornet, rootsift_vlad
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.view import resized

SIDE_PX = 200
SAMPLE_VIEWS = 512
DRAWS = 400
NEIGHBOURS, STRIDE = 10, 2
"""Views so near in the run show the same place; views that follow each other match views at most so far apart."""
ROWS = 1024


@jax.jit
def _look_at_whole(image: UInt8[ArrayLike, "I J 3"]) -> Mapping[str, Array]:
    whole = resized(jnp.asarray(image, jnp.float32) / 255, SIDE_PX)
    return rootsift_vlad.look(whole, jnp.ones(whole.shape[:2], bool), image)


def joint(weights: Path | None, arithmetic: Arithmetic) -> Descriptor:
    """The descriptor, with floornet's weights as `models.floornet.open_floornet` finds them."""
    floor = floornet.floornet(weights, arithmetic)

    def look(
        view: Float[Array, "H W 3"], seen: Bool[Array, "H W"], image: UInt8[ArrayLike, "I J 3"]
    ) -> Mapping[str, Array]:
        parts = {"floor": floor.look(view, seen, image), "whole": _look_at_whole(jnp.asarray(image))}
        return {f"{part}_{name}": array for part, arrays in parts.items() for name, array in arrays.items()}

    return Descriptor(look, unite, jitted=False, has_maps=True, whole_image=True, weights=floor.weights)


def distinctness(vectors: Float[Array, "N V"]) -> float:
    """How well the cosines s_ij of a run's views tell matches from others, the weight of Fisher's discriminant.

        (mean_i max_j s_ij - chance) / var s_ij,    j != i,    at least 0

    chance is what the largest of N - 1 independent normal values with the mean and the variance of s_ij would be: their
    mean largest plus its standard deviation.
    """
    rows = np.unique(np.linspace(0, len(vectors) - 1, min(len(vectors), SAMPLE_VIEWS)).round().astype(int))
    chosen = np.asarray(vectors, np.float64)[rows]
    count = len(rows) - 1
    if count < 2:
        return 0.0
    cosines = (chosen @ chosen.T)[~np.eye(len(rows), dtype=bool)].reshape(-1, count)
    if (spread := cosines.std()) < 1e-9:
        return 0.0
    largest = np.random.default_rng(0).standard_normal((DRAWS, count)).max(1)
    chance = cosines.mean() + spread * (largest.mean() + largest.std())
    return max(0.0, float((cosines.max(1).mean() - chance) / spread**2))


def steadiness(vectors: Float[Array, "N V"]) -> float:
    """How often the best matches of two views that follow each other do so too, STRIDE apart at most.

    A view's neighbours in the run do not count as its matches. A robot that drives past the same places again gives
    nearly 1, what matches by chance or by sameness little; 1 too for a run that is too short to tell.
    """
    every = np.asarray(vectors, np.float32)
    number = np.arange(len(every))
    if len(every) < 2 * (NEIGHBOURS + 1):
        return 1.0
    best = []
    for rows in np.split(number, range(ROWS, len(number), ROWS)):
        near = np.abs(rows[:, None] - number[None, :]) <= NEIGHBOURS
        best.append(np.argmax(np.where(near, -np.inf, every[rows] @ every.T), 1))
    return float(np.mean(np.abs(np.diff(np.concatenate(best))) <= STRIDE))


def floor_share(floor: Float[Array, "N V"], whole: Float[Array, "N W"]) -> float:
    """a: the floor's distinctness times steadiness over the sum of both parts'; a half where neither has any."""
    a, b = (distinctness(vectors) * steadiness(vectors) for vectors in (floor, whole))
    return a / (a + b) if a + b > 0 else 0.5


def unite(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    """Both parts, weighed and joined."""
    floor, whole = (
        describe({name: kept[f"{part}_{name}"] for name in ("map", "cells")}, seed=seed)
        for part, describe in (("floor", floornet.unite), ("whole", rootsift_vlad.unite))
    )
    a = floor_share(floor.vectors[..., 0], whole.vectors[..., 0])
    image = whole.vectors[..., 0]
    straight = jnp.concatenate([math.sqrt(a) * floor.vectors[..., 0], math.sqrt(1 - a) * image], 1)
    turned = jnp.concatenate([floor.vectors[..., 1], jnp.zeros_like(image)], 1)
    return dataclasses.replace(floor, vectors=jnp.stack([straight, turned], -1), share=a)
