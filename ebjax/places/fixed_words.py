"""Words that do not come from the run: components and a vocabulary, learned once, shipped, closed under R_pi.

Every channel is even or odd under R_pi, and every word has its mirror image among the words: what a view is told by,
turned by pi, is a signed permutation of itself. Words belong to the weights that made the maps they were learned from:
the file says which. `python -m ebjax.train --config configs/train/words.yaml` makes them.
"""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ebjax.geometry.pytree import pytree
from ebjax.models.eye import open_eye
from ebjax.models.weights import load_metadata, load_weights, save_weights

FORMAT = 1
"""Of the file, and of what a place is made of."""
NAMES = ("floornet", "rootsift-vlad")
"""Descriptors that have words."""
NO_WEIGHTS = "none"
ARRAYS = ("mean", "basis", "parity", "words", "alpha")


@pytree
class FixedWords:
    """What turns the map of a view into its place.

    Attributes:
      mean: of all cells, the same under R_pi.
      basis: orthonormal components, one a column, each even or odd.
      parity: 1 for even components, -1 for odd ones.
      words: the first half of the vocabulary, in components; the second half is `words * parity`.
      alpha: of the soft assignment, as in `vlad.Vocabulary`.
      name: of the descriptor.
      version: changes whenever a place would.
    """

    mean: Float[Array, "D0"]
    basis: Float[Array, "D0 D"]
    parity: Float[Array, "D"]
    words: Float[Array, "K D"]
    alpha: Float[Array, ""]
    name: str = dataclasses.field(metadata={"static": True})
    version: str = dataclasses.field(metadata={"static": True})

    def __repr__(self) -> str:
        count, channels = self.words.shape
        return f"FixedWords({self.name}, {2 * count} words of {channels} channels, version {self.version})"


def fixed_words(name: str, weights: Path | None = None) -> FixedWords:
    """The words of a descriptor.

    Args:
      name: one of NAMES.
      weights: of floornet, as `models.floornet.open_floornet` takes them; words of weights that are not ours lie beside
        them.

    Raises:
      ValueError: the descriptor has no words; there are none for these weights, or they are damaged.
      OSError: a file cannot be read.
    """
    if name not in NAMES:
        raise ValueError(f"descriptor {name!r} has no fixed words; these have: {', '.join(NAMES)}")
    source = weights_of(name, weights)
    made_with = digest_of(source)
    own = words_path(name, Path(__file__).parent)
    if _made_with(own) == made_with:
        return _read(own, name)
    assert source is not None
    remedy = (
        f"make them with `python -m ebjax.train --task words --descriptors {name} --weights {source} "
        f"--out {source.parent}`"
    )
    beside = words_path(name, source.parent)
    if not beside.is_file():
        raise ValueError(f"{source}: no words for these weights ({beside} does not exist); {remedy}")
    if _made_with(beside) != made_with:
        raise ValueError(f"{beside}: these words belong to other weights than {source}; {remedy}")
    return _read(beside, name)


def weights_of(name: str, weights: Path | None) -> Path | None:
    """The file that a descriptor's weights are read from; None where it has none."""
    return open_eye(weights).path if name == "floornet" else None


def digest_of(weights: Path | None) -> str:
    """Of a weights file."""
    return NO_WEIGHTS if weights is None else hashlib.sha256(weights.read_bytes()).hexdigest()[:16]


def words_path(name: str, folder: Path) -> Path:
    """Where the words of a descriptor lie in a folder."""
    return folder / f"{name}.words.safetensors"


def save_words(path: Path, name: str, arrays: dict[str, np.ndarray], weights: Path | None) -> None:
    """Writes words, float32, that were learned from maps of these weights."""
    whole = {key: np.asarray(arrays[key], np.float32) for key in ARRAYS}
    save_weights(path, f"{name}.words", whole, {"format": str(FORMAT), "weights": digest_of(weights)})


def _made_with(path: Path) -> str | None:
    return load_metadata(path).get("weights")


def _read(path: Path, name: str) -> FixedWords:
    kind, arrays = load_weights(path)
    if kind != f"{name}.words" or sorted(arrays) != sorted(ARRAYS):
        raise ValueError(f"{path}: holds {kind}, not the words of {name}")
    if (made := load_metadata(path).get("format")) != str(FORMAT):
        raise ValueError(f"{path}: words of format {made}, this version of ebjax reads {FORMAT}; make them again")
    # Of what is in the file: the order of a header's entries is by chance.
    content = hashlib.sha256((_made_with(path) or "").encode())
    for key in ARRAYS:
        content.update(arrays[key].tobytes())
    values: dict[str, Any] = {key: arrays[key] for key in ARRAYS}
    return FixedWords(**values, name=name, version=f"{FORMAT}-{content.hexdigest()[:12]}")
