"""Reads the struct of NetVLAD's .mat files, of MATLAB's version 5 (SciPy) or 7.3 (HDF5), into a flat mapping.

Keys are `layers.{i}.weights.{n}`, counted from 0, and `meta.normalization.averageImage`; arrays have MATLAB's shapes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

AVERAGE = "meta.normalization.averageImage"


def read_struct(path: Path) -> dict[str, np.ndarray]:
    """The weights of every layer of the struct `net`.

    Raises:
      Exception: of whatever kind, where the file is damaged or holds something else.
    """
    with open(path, "rb") as file:
        version_5 = not file.read(10).startswith((b"MATLAB 7.3", b"\x89HDF"))
    return _version_5(path) if version_5 else _version_7(path)


def _version_5(path: Path) -> dict[str, np.ndarray]:
    from scipy.io import loadmat

    net = loadmat(path, variable_names=["net"], struct_as_record=False)["net"][0, 0]
    state = {AVERAGE: net.meta[0, 0].normalization[0, 0].averageImage}
    for i, layer in enumerate(net.layers.reshape(-1)):
        weights = getattr(layer[0, 0], "weights", np.empty(0))
        state |= {f"layers.{i}.weights.{n}": array for n, array in enumerate(weights.reshape(-1))}
    return _numbers(state)


def _version_7(path: Path) -> dict[str, np.ndarray]:
    import h5py

    with h5py.File(path, "r") as file:

        def cell(dataset: Any) -> list[Any]:
            # An empty cell is stored as its dimensions, which are no references.
            return [file[reference] for reference in np.ravel(dataset)] if dataset.dtype.kind == "O" else []

        net = file["net"]
        # HDF5 has the axes of MATLAB's column-major arrays in reverse.
        state = {AVERAGE: net["meta"]["normalization"]["averageImage"][()].T}
        for i, layer in enumerate(cell(net["layers"])):
            weights = cell(layer["weights"]) if "weights" in layer else []
            state |= {f"layers.{i}.weights.{n}": dataset[()].T for n, dataset in enumerate(weights)}
    return _numbers(state)


def _numbers(state: Mapping[str, Any]) -> dict[str, np.ndarray]:
    if wrong := [key for key, array in state.items() if np.asarray(array).dtype.kind != "f"]:
        raise ValueError(f"{wrong[0]} does not hold real numbers")
    return {key: np.asarray(array) for key, array in state.items()}
