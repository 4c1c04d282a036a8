"""The task `words`: the vocabulary that place descriptors come with, from views of synthetic floors of every family."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ebjax.command import progress
from ebjax.models.floornet import parity
from ebjax.places.descriptor import Descriptor, descriptor
from ebjax.places.descriptor_map import rotate_pi_scales
from ebjax.places.fixed_words import NAMES, save_words, weights_of, words_path
from ebjax.places.learn_words import WORDS, learn_words
from ebjax.train.canvas import NAMES as FAMILIES
from ebjax.train.canvas import make_canvas
from ebjax.train.views import sample_pairs


@dataclasses.dataclass(frozen=True)
class Config:
    """Learns the words of place descriptors on synthetic floors."""

    descriptors: tuple[str, ...] = ("floornet",)
    """Whose words: floornet, rootsift-vlad."""
    weights: Path | None = None
    """Of floornet: a .safetensors file, or a folder with floornet.safetensors; None: those that come with ebjax."""
    canvases: int = 56
    """Synthetic floors, families in turn."""
    places: int = 6
    """Of each canvas, at most 9; each is seen from both sides."""
    side_px: int = 200
    """Of a view, a multiple of 8."""
    cells: int = 60_000
    """Of all views together, that words are learned from."""
    seed: int = 17
    """Of floors, views and words; not the one that floornet was trained with."""


def check(config: Config) -> None:
    """Raises ValueError that names the key which cannot be."""
    if unknown := sorted(set(config.descriptors) - set(NAMES)):
        raise ValueError(f"descriptors: {', '.join(unknown)} has no words; these have: {', '.join(NAMES)}")
    if not config.descriptors:
        raise ValueError(f"descriptors is empty; give some of {', '.join(NAMES)}")
    if config.canvases < len(FAMILIES):
        raise ValueError(f"canvases is {config.canvases}: needs {len(FAMILIES)} or more, one of every family")
    if not 1 <= config.places <= 9:
        raise ValueError(f"places is {config.places}: needs 1 to 9 of a canvas")
    if config.side_px < 64 or config.side_px % 8:
        raise ValueError(f"side_px is {config.side_px}: needs a multiple of 8, at least 64")
    if config.cells < 2 * WORDS:
        raise ValueError(f"cells is {config.cells}: needs {2 * WORDS} or more")


def turn_of(name: str, dimension: int) -> Callable[[Array], Array]:
    """R_pi of the descriptors of a point."""
    if name == "floornet":
        signs = parity(dimension)
        return lambda values: values * jnp.broadcast_to(jnp.asarray(signs, values.dtype), values.shape)
    return rotate_pi_scales


def views(config: Config) -> Iterator[tuple[Float[Array, "S S"], Float[Array, "S S"]]]:
    """Grey views of all places from both sides, and what each shows."""
    root = jax.random.key(config.seed)
    for number in progress(range(config.canvases), config.canvases, "laying floors"):
        canvas = jnp.asarray(make_canvas(number, seed=config.seed))[None]
        pairs = sample_pairs(canvas, config.places, config.side_px, key=jax.random.fold_in(root, number))
        for several, seen in ((pairs.first, pairs.seen_first), (pairs.second, pairs.seen_second)):
            for view in several:
                yield view, seen


def cells_of(chosen: Descriptor, view: Float[Array, "S S"], seen: Float[Array, "S S"]) -> Float[np.ndarray, "C D"]:
    """The descriptors of the cells of a view that are seen."""
    rgb = jnp.repeat(view[..., None], 3, -1)
    kept = chosen.look(rgb, seen > 0.5, np.zeros((1, 1, 3), np.uint8))
    return np.asarray(kept["map"])[np.asarray(kept["cells"])].astype(np.float32)


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Looks, learns, writes NAME.words.safetensors of every descriptor."""
    check(config)
    if resume:
        raise ValueError("--resume: the task words keeps no checkpoints; run it again without")
    known = {name: descriptor(name, config.weights if name == "floornet" else None) for name in config.descriptors}
    looks = {
        name: dataclasses.replace(one, look=jax.jit(one.look)) if one.jitted else one for name, one in known.items()
    }
    rng = np.random.default_rng(config.seed)
    share = -(-config.cells // (2 * config.canvases * config.places))
    found: dict[str, list[np.ndarray]] = {name: [] for name in looks}
    for view, seen in views(config):
        for name, chosen in looks.items():
            cells = cells_of(chosen, view, seen)
            found[name].append(rng.permutation(cells)[:share])
    for name, parts in found.items():
        cells = np.concatenate(parts)[: config.cells]
        key = jax.random.key(config.seed)
        arrays = learn_words(jnp.asarray(cells), turn_of(name, cells.shape[1]), key=key)
        path = words_path(name, out)
        save_words(path, name, arrays, weights_of(name, config.weights))
        print(f"{path}: words from {len(cells)} cells of {config.canvases} floors")
