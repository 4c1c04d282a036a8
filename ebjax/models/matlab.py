"""Reads the struct of NetVLAD's .mat files, of MATLAB's version 5 or 7.3 (HDF5), into a flat mapping.

Keys are `layers.{i}.weights.{n}`, counted from 0, and `meta.normalization.averageImage`; arrays have MATLAB's shapes.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ebjax.models.matlab5 import Cells, Structs, read_variable

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
    net = _struct(read_variable(path, "net"), "net")
    normalization = _struct(_struct(net.get("meta"), "net.meta").get("normalization"), "net.meta.normalization")
    state = {AVERAGE: normalization["averageImage"]}
    layers = net["layers"]
    if not isinstance(layers, Cells):
        raise ValueError("net.layers is no cell array")
    for i, layer in enumerate(layers.parts):
        weights = _struct(layer, f"net.layers{{{i + 1}}}").get("weights")
        if isinstance(weights, Cells):
            state |= {f"layers.{i}.weights.{n}": array for n, array in enumerate(weights.parts)}
    return _numbers(state)


def _struct(value: Any, name: str) -> dict[str, Any]:
    """The fields of a single struct."""
    if not isinstance(value, Structs) or len(value.parts) != 1:
        raise ValueError(f"{name} is no struct")
    return value.parts[0]


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
