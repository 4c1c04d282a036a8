"""Reads published checkpoints, whatever their format, into published keys and arrays; nothing of them is executed.

torch (.pth, .pt, .pth.tar: the names do not matter, the first bytes do), MATLAB (.mat) and safetensors. `taking` gives
the keys to a network's `convert`, which has to take every one.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file

from ebjax.models.matlab import read_struct
from ebjax.models.pickled import Tensor, read_torch
from ebjax.models.weights import in_short

WRAPPERS = ("state_dict", "model")  # where training scripts put the weights beside their own state
Take = Callable[[str], np.ndarray]
"""Gives the array of a published key; ValueError where there is none."""


def read_checkpoint(path: str | Path) -> dict[str, np.ndarray]:
    """The published keys of a checkpoint and their arrays.

    Raises:
      ValueError: truncated, hostile, or no checkpoint; one line that names the file.
      OSError: it cannot be read.
    """
    path = Path(path)
    with open(path, "rb") as file:
        first = file.read(600)
    try:
        if first.startswith((b"MATLAB", b"\x89HDF")):
            return read_struct(path)
        if first.startswith((b"PK\x03\x04", b"\x80")):
            return _tensors(path)
        if first[8:9] == b"{":
            return load_file(path)
        if first[257:262] == b"ustar":
            raise ValueError("torch's tar format of before 2017; save it again with a torch of today")
        raise ValueError("neither torch's, nor MATLAB's, nor safetensors")
    except OSError as error:
        raise ValueError(f"{path}: not a whole checkpoint ({error})") from None
    except Exception as error:  # a damaged file can raise anything
        missing = "misses " * isinstance(error, KeyError)
        raise ValueError(f"{path}: not a whole checkpoint ({missing}{in_short(error)})") from None


@contextmanager
def taking(state: Mapping[str, np.ndarray], unused: str | None = None) -> Iterator[Take]:
    """Gives a function that takes the array of a key; at the end every key must have been taken.

    Args:
      state: published keys and arrays; `num_batches_tracked` of batch normalisation need not be taken.
      unused: keys that begin so need not be taken either.

    Raises:
      ValueError: a key is missing, or is left over.
    """
    rest = {key: np.asarray(array) for key, array in state.items() if not key.endswith("num_batches_tracked")}
    if unused is not None:
        rest = {key: array for key, array in rest.items() if not key.startswith(unused)}

    def take(key: str) -> np.ndarray:
        if key not in rest:
            raise ValueError(f"key {key!r} is missing in the checkpoint")
        return rest.pop(key)

    yield take
    if rest:
        raise ValueError(f"unexpected key {next(iter(rest))!r} in the checkpoint")


def _tensors(path: Path) -> dict[str, np.ndarray]:
    root, numbers = read_torch(path)
    for key in WRAPPERS:
        if isinstance(root, dict) and isinstance(root.get(key), dict):
            root = root[key]
            break
    if not isinstance(root, dict) or not root:
        raise ValueError("it holds no tensors by name")
    if other := [key for key, value in root.items() if not isinstance(value, Tensor)]:
        raise ValueError(f"{other[0]!r} in it is not a tensor")
    return {str(key): numbers(tensor) for key, tensor in root.items()}
