"""Seeds that hold arrays: checkpoints of torch, MATLAB and safetensors, ebjax's own weights, cached features."""

import io
import tempfile
from collections import OrderedDict
from pathlib import Path

import h5py
import numpy as np
from safetensors.numpy import save
from scipy.io import savemat

from ebjax.io.cache import Cache

from ..models.conftest import _write_torch
from .mutate import Input, input_from

STATE = OrderedDict(
    {"a.weight": np.arange(24, dtype=np.float32).reshape(2, 3, 2, 2), "a.bias": np.array([1.5, -2]), "n": np.array(7)}
)


def _matlab_5() -> bytes:
    weights = np.empty((1, 2), object)
    weights[0] = np.ones((3, 3), np.float32), np.zeros((3, 1), np.float32)
    layers = np.empty((1, 2), object)
    layers[0] = {"type": "conv", "weights": weights}, {"type": "relu"}
    net = {"layers": layers, "meta": {"normalization": {"averageImage": np.ones((1, 3), np.float32)}}}
    out = io.BytesIO()
    savemat(out, {"net": net})
    return b"MATLAB 5.0 MAT-file".ljust(124) + out.getvalue()[124:]  # without the date


def _matlab_7() -> bytes:
    out = io.BytesIO()
    with h5py.File(out, "w") as file:
        array = file.create_dataset("#refs#/w", data=np.ones((3, 3), np.float32))
        layer = file.create_group("#refs#/l")
        layer.create_dataset("weights", data=[[array.ref]], dtype=h5py.ref_dtype)
        net = file.create_group("net")
        net.create_dataset("layers", data=[[layer.ref]], dtype=h5py.ref_dtype)
        net["meta/normalization/averageImage"] = np.ones((3, 1), np.float32)
    return out.getvalue()


def checkpoints() -> list[Input]:
    found = []
    with tempfile.TemporaryDirectory() as folder:
        wrapped = {"epoch": 3, "best": 0.5, "state_dict": STATE, "log": [1, (2,)]}
        for name, content in (("plain", STATE), ("wrapped", wrapped)):
            for stream in (False, True):
                path = Path(folder) / f"{name}_{'stream' if stream else 'zip'}.pth"
                _write_torch(path, content, stream=stream)
                found.append(input_from(path))
    arrays = {key: np.ascontiguousarray(array) for key, array in STATE.items()}
    contents = {"a.safetensors": save(arrays), "ours.safetensors": save(arrays, {"ebjax_model": "floornet"})}
    contents |= {"five.mat": _matlab_5(), "seven.mat": _matlab_7()}
    return found + [Input({name: content}, name) for name, content in contents.items()]


def caches() -> list[Input]:
    """A folder of caches with two shards."""
    with tempfile.TemporaryDirectory() as folder:
        cache = Cache(folder, "model", {"size": 3})
        for key in ("one", "two"):
            cache.put(key, {"points": np.arange(6.0).reshape(3, 2), "score": np.ones(3, np.float16)})
            cache.flush()
        return [input_from(Path(folder))]
