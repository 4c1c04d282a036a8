"""Published checkpoints -> our weights: recognised by their keys, renamed, laid out anew, tried on the network."""

import hashlib
from pathlib import Path

import numpy as np

from ebjax.models.catalogue import MODELS, recognise, resolve, restore
from ebjax.models.checkpoint import read_checkpoint


def convert_checkpoint(path: str | Path) -> tuple[str, dict[str, np.ndarray], dict[str, str]]:
    """Converts one file, for `weights.save_weights`.

    Returns:
      The network's name, its arrays (float32), and where they come from: the file's name and SHA-256.

    Raises:
      ValueError: no checkpoint, of no known network, or one with keys, shapes or numbers that do not fit; one line.
      OSError: it cannot be read.
    """
    path = Path(path)
    state = read_checkpoint(path)
    try:
        name = recognise(state)
        arrays = {key: array.astype(np.float32) for key, array in resolve(MODELS[name].convert)(state).items()}
        restore(name, arrays)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    if broken := [key for key, array in arrays.items() if not np.isfinite(array).all()]:
        raise ValueError(f"{path}: {broken[0]} has values that are not finite")
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return name, arrays, {"source": path.name, "source_sha256": digest}
