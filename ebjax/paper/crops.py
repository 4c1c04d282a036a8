"""Retrieval among overlapping crops of photographed floors: do descriptors rank as they do on synthetic floors?

The database holds every crop; a query is one of them turned by pi, seen from slightly elsewhere in other light. The
right answer is that crop alone, though its neighbours share half of it. Descriptors learn from all crops, as of a run.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from ebjax.command import progress
from ebjax.models.luma import luma
from ebjax.paper.looks import look_at
from ebjax.paper.retrieval import FLOOR, TURNED, WAYS
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.descriptor_map import rotate_pi_map
from ebjax.places.rootsift_vlad import ROOTSIFT_VLAD, project_all
from ebjax.places.search import search
from ebjax.places.view import resized, unit

SIDE_PX, STRIDE_PX = 200, 100
SHORTLIST = 50
THUMBNAIL_PX = 24
ROTATION_DEG, SCALE, SHIFT, PERSPECTIVE = 8.0, 0.14, 0.09, 0.06
GAMMA, GAIN, SHADOW, GLARE, NOISE = (0.5, 1.8), (0.7, 1.2), (0.45, 0.9), 0.6, 0.02

Crop = tuple[str, float, float]
"""Photograph, and the crop's centre in it (x, y), px."""


def cut(photographs: Mapping[str, UInt8[np.ndarray, "_ _ 3"]], most: int) -> list[Crop]:
    """Crops of SIDE_PX every STRIDE_PX, an even choice of `most`.

    Raises:
      ValueError: no photograph is large enough.
    """
    crops = []
    for name, image in photographs.items():
        rows, columns = (np.arange(0, length - SIDE_PX + 1, STRIDE_PX) for length in image.shape[:2])
        middle = (SIDE_PX - 1) / 2
        crops += [(name, float(x) + middle, float(y) + middle) for y in rows for x in columns]
    if not crops:
        raise ValueError(f"none of {len(photographs)} images has {SIDE_PX} x {SIDE_PX} pixels; give larger photographs")
    return [crops[k] for k in np.unique(np.linspace(0, len(crops) - 1, min(most, len(crops))).round().astype(int))]


def seen_again(
    photograph: UInt8[np.ndarray, "H W 3"], crop: Crop, rng: np.random.Generator
) -> tuple[UInt8[np.ndarray, "S S 3"], Float[np.ndarray, "3 3"]]:
    """The crop turned by pi, from another viewpoint, in another light; and its pixels to those of the photograph."""
    image, photograph_from_query = _warped(photograph, crop, rng)
    return relit(image, rng), photograph_from_query


def _warped(photograph: np.ndarray, crop: Crop, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rotation, scale, shift and perspective about the crop's centre; beyond the photograph it is mirrored."""
    angle = np.pi + np.radians(rng.uniform(-ROTATION_DEG, ROTATION_DEG))
    scale = 1 + rng.uniform(-SCALE, SCALE)
    shift = rng.uniform(-SHIFT, SHIFT, 2) * SIDE_PX
    tilt = rng.uniform(-PERSPECTIVE, PERSPECTIVE, 2) / SIDE_PX
    c, s, middle = np.cos(angle) * scale, np.sin(angle) * scale, (SIDE_PX - 1) / 2
    from_centre = np.array([[1, 0, -middle], [0, 1, -middle], [0, 0, 1]])
    moved = np.array([[c, -s, crop[1] + shift[0]], [s, c, crop[2] + shift[1]], [0, 0, 1]])
    tilted = np.array([[1, 0, 0], [0, 1, 0], [tilt[0], tilt[1], 1]])
    photograph_from_query = moved @ tilted @ from_centre
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size, border = (SIDE_PX, SIDE_PX), cv2.BORDER_REFLECT_101
    image = cv2.warpPerspective(photograph, photograph_from_query, size, flags=flags, borderMode=border)
    return image, photograph_from_query


def relit(image: UInt8[np.ndarray, "S S 3"], rng: np.random.Generator) -> UInt8[np.ndarray, "S S 3"]:
    """Gamma, gain, the soft edge of a shadow, a saturated spot of glare, noise."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] / SIDE_PX - 0.5
    value = (image / 255.0) ** rng.uniform(*GAMMA) * rng.uniform(*GAIN)
    way = rng.uniform(0, 2 * np.pi)
    edge = (np.cos(way) * x + np.sin(way) * y - rng.uniform(-0.4, 0.4)) / 0.03
    value *= (1 - (1 - rng.uniform(*SHADOW)) / (1 + np.exp(np.clip(-edge, -50, 50))))[..., None]
    at = rng.uniform(-0.5, 0.5, 2)
    width = rng.uniform(0.05, 0.2)
    value += GLARE * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * width**2))[..., None]
    value += rng.normal(0, NOISE, value.shape)
    return np.round(255 * np.clip(value, 0, 1)).astype(np.uint8)


def _thumbnail(view: Any, seen: Any, image: Any) -> dict[str, Any]:
    small = resized(luma(view)[..., None], THUMBNAIL_PX)[..., 0]
    return {"small": small - small.mean()}


def _thumbnails(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    small = jnp.asarray(kept["small"])
    both = [unit(side.reshape(len(small), -1)) for side in (small, small[:, ::-1, ::-1])]
    return Places(jnp.stack(both, -1))


def _grids(kept: Mapping[str, np.ndarray], *, seed: int = 0) -> Places:
    maps, space = project_all(kept["map"], kept["cells"])
    both = [unit(side.reshape(len(maps), -1)) for side in (maps, rotate_pi_map(maps, space))]
    return Places(jnp.stack(both, -1))


BASELINES = {"thumbnail": Descriptor(_thumbnail, _thumbnails), "rootsift grid": Descriptor(ROOTSIFT_VLAD.look, _grids)}
"""A view of 24 x 24 px, and the descriptor map compared cell by cell."""


def describe(chosen: Descriptor, images: list[UInt8[np.ndarray, "S S 3"]]) -> dict[str, np.ndarray]:
    """What a descriptor keeps of the images as floor views, stacked."""
    seen = jnp.ones((SIDE_PX, SIDE_PX), bool)
    shown = progress(images, len(images), "describing crops")
    return look_at(chosen, ((jnp.asarray(i, jnp.float32) / 255, seen, i) for i in shown))


def recall(kept: Mapping[str, np.ndarray], chosen: Descriptor, ranking: str, *, seed: int) -> dict[str, float]:
    """R@1 without and with R_pi; the first half of the rows is the database, the second their queries in order."""
    places = chosen.unite(kept, seed=seed)
    count = len(places.vectors) // 2
    rows = np.arange(count, 2 * count)
    found = {}
    for seen_as in (FLOOR, TURNED):
        allowed = np.zeros((count, 2 * count, 2), bool)
        allowed[:, :count] = np.array(WAYS[seen_as])[None, None, :]
        best = search(places, jnp.asarray(allowed), ranking=ranking, queries=rows, top=SHORTLIST)
        found[seen_as] = float((np.asarray(best.j)[:, 0] == np.arange(count)).mean())
    return found


def images_of(
    photographs: Mapping[str, UInt8[np.ndarray, "_ _ 3"]], crops: list[Crop], *, seed: int
) -> tuple[list[UInt8[np.ndarray, "S S 3"]], list[Float[np.ndarray, "3 3"]]]:
    """All crops, then their queries in the same order; and for each crop where its pixels lie in its query."""
    rng, half = np.random.default_rng(seed), (SIDE_PX - 1) / 2
    database, queries, motions = [], [], []
    for name, x, y in crops:
        top, left = round(y - half), round(x - half)
        database.append(np.ascontiguousarray(photographs[name][top : top + SIDE_PX, left : left + SIDE_PX]))
        query, photograph_from_query = seen_again(photographs[name], (name, x, y), rng)
        photograph_from_crop = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        queries.append(query)
        motions.append(np.linalg.inv(photograph_from_query) @ photograph_from_crop)
    return database + queries, motions


def spread(values: Mapping[str, Mapping[str, float]], by: str) -> Float[np.ndarray, " M"]:
    """One column of a table as an array."""
    return np.array([row[by] for row in values.values()])
