"""Weights as safetensors: each array under its dotted path ("conv1_1.kernel"), the network's name as metadata.

Convolution kernels are stored as they are used: height, width, in, out.
"""

import os
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import ArrayLike
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

NAME = "ebjax_model"


def save_weights(
    path: str | Path, model_name: str, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None
) -> None:
    """Writes a weights file whole or not at all.

    Args:
      path: the file; its folder is made.
      model_name: a name of `ebjax.models.catalogue.MODELS`.
      arrays: as `flat_arrays` gives them.
      metadata: whatever else should stand in the file's header.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(21, "is a folder; name a file", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    data = save({key: np.asarray(a, order="C") for key, a in arrays.items()}, {**(metadata or {}), NAME: model_name})
    temporary = path.parent / f".{path.name}.{uuid.uuid4().hex[:8]}.partial"
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def load_weights(path: str | Path) -> tuple[str, dict[str, np.ndarray]]:
    """Reads what `save_weights` wrote: the network's name and its arrays.

    Raises:
      ValueError: not a safetensors file, truncated, or not one of ours.
      OSError: it cannot be read.
    """
    with open(path, "rb"):  # an OSError that names the file
        pass
    try:
        with safe_open(path, framework="np") as file:
            name = (file.metadata() or {}).get(NAME)
            arrays = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    except SafetensorError as error:
        raise ValueError(f"{path}: not a whole safetensors file ({in_short(error)})") from None
    if name is None:
        raise ValueError(
            f"{path}: not weights of ebjax; make them with `python -m ebjax.models convert CHECKPOINT OUT.safetensors`"
        )
    return name, arrays


def load_metadata(path: str | Path) -> dict[str, str]:
    """What else stands in the header of a weights file.

    Raises:
      ValueError: not a safetensors file, or truncated.
      OSError: it cannot be read.
    """
    with open(path, "rb"):  # an OSError that names the file
        pass
    try:
        with safe_open(path, framework="np") as file:
            return dict(file.metadata() or {})
    except SafetensorError as error:
        raise ValueError(f"{path}: not a whole safetensors file ({in_short(error)})") from None


def in_short(error: Exception) -> str:
    """What an error of another library says, in one line that is not too long."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def flat_arrays(module: nnx.Module) -> dict[str, Any]:
    """Every parameter and buffer of a network under its dotted path."""
    state = nnx.state(module, nnx.Not(nnx.RngState))
    return {".".join(map(str, path)): leaf[...] for path, leaf in nnx.to_flat_state(state)}


def load_into(module: nnx.Module, arrays: Mapping[str, ArrayLike]) -> None:
    """Sets every parameter and buffer of a network, which may be abstract (from `nnx.eval_shape`).

    Args:
      module: changed in place.
      arrays: one for each of `flat_arrays(module)`, of the same shape; they take its dtype.

    Raises:
      ValueError: a key is missing or left over, or a shape is wrong.
    """
    state = nnx.state(module, nnx.Not(nnx.RngState))
    leaves = {".".join(map(str, path)): leaf for path, leaf in nnx.to_flat_state(state)}
    if missing := sorted(leaves.keys() - arrays.keys()):
        raise ValueError(f"{_some(missing)} missing; are these the weights of another network?")
    if extra := sorted(arrays.keys() - leaves.keys()):
        raise ValueError(f"{_some(extra)} not in the network; are these the weights of another network?")
    for key, leaf in leaves.items():
        if np.shape(arrays[key]) != tuple(leaf.shape):
            raise ValueError(f"{key}: shape {np.shape(arrays[key])}, the network's is {tuple(leaf.shape)}")
    nnx.update(module, nnx.map_state(lambda path, leaf: leaf.replace(_as(arrays, path, leaf)), state))


def kernel_from_torch(array: np.ndarray) -> np.ndarray:
    """A convolution's out, in, height, width -> height, width, in, out; a matrix is transposed, a vector as it is."""
    return np.ascontiguousarray(np.transpose(array, (2, 3, 1, 0)) if array.ndim == 4 else array.T)


def folded_norm(
    name: str,
    kernel: np.ndarray,
    mean: np.ndarray,
    variance: np.ndarray,
    epsilon: float,
    scale: np.ndarray | float = 1.0,
    shift: np.ndarray | float = 0.0,
) -> dict[str, np.ndarray]:
    """The kernel and bias of a convolution without bias that takes over the batch normalisation behind it.

    Args:
      name: of the convolution.
      kernel: height, width, in, out.
      mean: of the normalisation, a number an output channel, as are the others.
      variance: likewise.
      epsilon: added to the variance.
      scale: of the normalised output.
      shift: likewise.
    """
    gain = scale / np.sqrt(variance.astype(np.float64) + epsilon)
    arrays = {f"{name}.kernel": kernel * gain, f"{name}.bias": shift - mean * gain}
    return {key: array.astype(np.float32) for key, array in arrays.items()}


def _as(arrays: Mapping[str, Any], path: tuple, leaf: Any) -> Any:
    return jnp.asarray(arrays[".".join(map(str, path))], leaf.dtype)


def _some(keys: list[str]) -> str:
    more = f" and {len(keys) - 3} more" if len(keys) > 3 else ""
    return f"{', '.join(keys[:3])}{more} {'is' if len(keys) == 1 else 'are'}"
