"""Compares every array of a folder of reference outputs with what our networks give for the same weights and images.

The folder holds `inputs.npz` ({tag}_rgb and {tag}_gray, uint8) and {network}__{tag}.npz, outputs of the published code.
A network's part is one function, named in REFERENCES as "module:attribute":

    deviations(arrays, image, reference) -> dict[str, Deviation]

      arrays      the network's weights after `convert`, as `load_weights` returns them: build the network with
                  `catalogue.restore(name, arrays)` or by hand
      image       `Image`: rgb uint8 H W 3 and grey uint8 H W, as the file stores them
      reference   the arrays of {network}__{tag}.npz
      returns     one `Deviation(error, tolerance)` for EVERY key of `reference`, and nothing else

`compare.Comparison` has the usual rules: `.map(name, hwc)` covers all of name__*, `.array(key, got, tolerance)` one
array and `.record(key, error, tolerance)` what needs a rule of its own (point sets: the error may be the share of
points without a partner). A key without a deviation stops the check: nothing is skipped.

Weights come from `seeded` with the folder's seed, or from a file of the folder; they pass through `recognise` and
`convert` like a downloaded checkpoint.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ebjax.models.catalogue import MODELS, recognise, resolve
from ebjax.models.checkpoint import read_checkpoint
from ebjax.models.compare import Deviation, Image
from ebjax.models.seeded import digest, seeded_state

_BACKBONES = "ebjax.models.check_backbones"
_FEATURES = "ebjax.models.check_features"


@dataclass(frozen=True)
class Reference:
    """Whose outputs the files of one prefix are."""

    deviations: str
    weights: str  # a network of `seeded`, or a checkpoint of the folder


REFERENCES = {
    "vgg16": Reference(f"{_BACKBONES}:vgg", "vgg16"),
    "vgg19": Reference(f"{_BACKBONES}:vgg", "vgg19"),
    "resnet50": Reference(f"{_BACKBONES}:resnet50", "resnet50"),
    "netvlad_mat": Reference(f"{_BACKBONES}:netvlad_matlab", "netvlad_mat"),
    "netvlad_nanne": Reference(f"{_BACKBONES}:netvlad_nanne", "netvlad_wpca"),
    "d2net": Reference(f"{_FEATURES}:d2net", "d2net"),
    "superpoint": Reference(f"{_FEATURES}:superpoint", "superpoint"),
    "alike_n": Reference(f"{_FEATURES}:alike", "alike-n.pth"),
    "alike_t": Reference(f"{_FEATURES}:alike", "alike-t.pth"),
}


def check_folder(
    folder: Path, seed: int | None = None, networks: tuple[str, ...] = ()
) -> Iterator[tuple[str, str, Deviation]]:
    """Yields (file, array, deviation) for every array of every reference file of a folder.

    Args:
      folder: as the module's docstring says.
      seed: of the weights; None reads it from the folder's README.md ("seed 13").
      networks: prefixes to check; none means all there are.

    Raises:
      ValueError: a file of an unknown network, an array no rule covers, an image that is missing, or weights whose
        digest in weights_sha256.json is another.
      OSError: the folder cannot be read.
    """
    files = _files(folder, networks)
    seed = _seed(folder) if seed is None else seed
    images = _arrays(folder / "inputs.npz")
    for network, tags in files.items():
        arrays = _weights(folder, REFERENCES[network].weights, seed)
        deviations: Callable[..., dict[str, Deviation]] = resolve(REFERENCES[network].deviations)
        for tag in tags:
            name = f"{network}__{tag}.npz"
            try:
                image = Image(images[f"{tag}_rgb"], images[f"{tag}_gray"])
            except KeyError as error:
                raise ValueError(f"{folder / 'inputs.npz'}: no {error.args[0]}, the image of {name}") from None
            reference = _arrays(folder / name)
            try:
                found = deviations(arrays, image, reference)
            except KeyError as error:
                raise ValueError(f"{folder / name}: there is no {error.args[0]}, or no rule for it") from None
            except ValueError as error:
                raise ValueError(f"{folder / name}: {error}") from None
            if unknown := sorted(reference.keys() - found.keys()):
                raise ValueError(f"{folder / name}: no rule for the array {unknown[0]!r}")
            yield from ((name, key, found[key]) for key in reference)


def _files(folder: Path, networks: tuple[str, ...]) -> dict[str, list[str]]:
    files: dict[str, list[str]] = {}
    if not folder.is_dir():
        raise NotADirectoryError(20, "not a folder", str(folder))
    for file in sorted(folder.glob("*.npz")):
        network, separator, tag = file.stem.partition("__")
        if file.name == "inputs.npz" or (networks and network not in networks):
            continue
        if not separator or network not in REFERENCES:
            raise ValueError(f"{file}: not NETWORK__IMAGE.npz of a known network ({', '.join(REFERENCES)})")
        files.setdefault(network, []).append(tag)
    if missing := [network for network in networks if network not in files]:
        raise ValueError(f"{folder}: no files of {missing[0]}; known networks are {', '.join(REFERENCES)}")
    if not files:
        raise ValueError(f"{folder}: no reference files NETWORK__IMAGE.npz")
    return files


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with open(path, "rb") as whole, np.load(whole, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except OSError:
        raise
    except Exception as error:  # zipfile, zlib and NumPy each have their own for a damaged file
        raise ValueError(f"{path}: not a whole .npz file ({error})") from None


def _seed(folder: Path) -> int:
    readme = folder / "README.md"
    text = readme.read_text(encoding="utf-8", errors="replace") if readme.exists() else ""
    if (found := re.search(r"seed\W{1,4}(\d+)", text)) is None:
        raise ValueError(f"{readme}: says no seed; give --seed")
    return int(found[1])


def _weights(folder: Path, source: str, seed: int) -> dict[str, np.ndarray]:
    """The weights in our layout, by way of the published one."""
    if source.endswith(".pth"):
        state: Mapping[str, np.ndarray] = read_checkpoint(folder / source)
    else:
        # VGG's classifier is 500 MB and no part of the network; ResNet's is.
        head = source == "resnet50"
        state = seeded_state(source, seed, head=head)
        digests = folder / "weights_sha256.json"
        known = json.loads(digests.read_text(encoding="utf-8")) if digests.exists() else {}
        if known.get(f"{source} {seed} head={head}", digest(state)) != digest(state):
            raise ValueError(f"{digests}: {source} of seed {seed} has another digest here")
    return resolve(MODELS[recognise(state)].convert)(state)
