"""Checkpoints: of random arrays under published keys, and written as torch does, in both of its formats, without it."""

import pickle
import struct
import sys
import types
import zipfile
from collections import OrderedDict

import jax.numpy as jnp
import numpy as np
import pytest

NORM = {"weight": (0.6, 1.4), "bias": (-0.2, 0.2), "running_mean": (-0.2, 0.2), "running_var": (0.5, 1.5)}
STORAGES = {"float32": "FloatStorage", "float64": "DoubleStorage", "float16": "HalfStorage", "int64": "LongStorage"}


class RandomCheckpoint:
    """Random float32 arrays by key, in `state`; a filter's variance is gain / fan-in."""

    def __init__(self, gain: float = 2.0):
        self.random, self.gain = np.random.default_rng(0), gain
        self.state: dict[str, np.ndarray] = {}

    def weight(self, key: str, *shape: int, gain: float | None = None) -> None:
        """A convolution's filters: out, in, height, width."""
        spread = ((gain or self.gain) / np.prod(shape[1:])) ** 0.5
        self.state[key] = (self.random.standard_normal(shape) * spread).astype(np.float32)

    def uniform(self, key: str, width: int, low: float, high: float) -> None:
        """A bias or its like."""
        self.state[key] = self.random.uniform(low, high, width).astype(np.float32)

    def norm(self, name: str, width: int, parts=tuple(NORM)) -> None:
        """A batch normalisation."""
        for part in parts:
            self.uniform(f"{name}.{part}", width, *NORM[part])
        self.state[f"{name}.num_batches_tracked"] = np.array(3)

    def alike_blocks(self, channels, dimension: int, deformed=()) -> None:
        """The four blocks that ALIKE and ALIKED have."""
        before = 3
        for n, width in enumerate(channels, 1):
            for k, inside in ((1, before), (2, width)):
                name = f"block{n}.conv{k}"
                if n in deformed:
                    self.weight(f"{name}.offset_conv.weight", 18, inside, 3, 3)
                    self.uniform(f"{name}.offset_conv.bias", 18, -1, 1)
                    name += ".regular_conv"
                self.weight(f"{name}.weight", width, inside, 3, 3)
                self.norm(f"block{n}.bn{k}", width)
            if n > 1:
                self.weight(f"block{n}.downsample.weight", width, before, 1, 1)
                self.uniform(f"block{n}.downsample.bias", width, -0.1, 0.1)
            self.weight(f"conv{n}.weight", dimension // 4, width, 1, 1)
            before = width


@pytest.fixture(scope="session")
def random_checkpoint():
    """Makes an empty one: random_checkpoint(gain=2.0)."""
    return RandomCheckpoint


@pytest.fixture(scope="session")
def image():
    """Noise, 50 x 71: no multiples of a network's cells."""
    return jnp.asarray(np.random.default_rng(1).random((50, 71, 3)), jnp.float32)


class _Storage:
    def __init__(self, array: np.ndarray, key: str):
        self.array, self.key = array, key


class _Tensor:
    def __init__(self, storage: _Storage):
        self.storage = storage

    def __reduce__(self):
        array = self.storage.array
        strides = tuple(stride // array.itemsize for stride in array.strides)
        rebuild = sys.modules["torch._utils"]._rebuild_tensor_v2
        return rebuild, (self.storage, 0, array.shape, strides, False, OrderedDict())


def _fake_torch() -> dict[str, types.ModuleType]:
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")

    def _rebuild_tensor_v2():
        raise AssertionError("a reader called it")

    _rebuild_tensor_v2.__module__, _rebuild_tensor_v2.__qualname__ = "torch._utils", "_rebuild_tensor_v2"
    utils._rebuild_tensor_v2 = _rebuild_tensor_v2
    for name in STORAGES.values():
        setattr(torch, name, type(name, (), {"__module__": "torch"}))
    torch._utils = utils
    return {"torch": torch, "torch._utils": utils}


@pytest.fixture
def write_torch():
    """Saves containers of arrays: write_torch(path, content, stream=False)."""
    return _write_torch


def _write_torch(path, content, *, stream: bool = False) -> None:
    """`stream` is the format of before torch 1.6."""
    storages: list[_Storage] = []

    def prepare(value):
        if isinstance(value, np.ndarray):
            storages.append(_Storage(value, str(len(storages))))
            return _Tensor(storages[-1])
        if isinstance(value, dict):
            return type(value)((key, prepare(item)) for key, item in value.items())
        return value

    class Pickler(pickle.Pickler):
        def persistent_id(self, value):
            if not isinstance(value, _Storage):
                return None
            kind = getattr(sys.modules["torch"], STORAGES[value.array.dtype.name])
            identity = ("storage", kind, value.key, "cpu", value.array.size)
            return (*identity, None) if stream else identity

    content = prepare(content)
    fake = _fake_torch()
    real = {name: sys.modules.get(name) for name in fake}
    sys.modules.update(fake)
    try:
        with open(path, "wb") if stream else zipfile.ZipFile(path, "w") as file:
            if stream:
                for head in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}):
                    pickle.dump(head, file, protocol=2)
                Pickler(file, protocol=2).dump(content)
                pickle.dump([storage.key for storage in storages], file, protocol=2)
                for storage in storages:
                    file.write(struct.pack("<q", storage.array.size) + storage.array.tobytes("A"))
            else:
                with file.open("archive/data.pkl", "w") as entry:
                    Pickler(entry, protocol=2).dump(content)
                for storage in storages:
                    file.writestr(f"archive/data/{storage.key}", storage.array.tobytes("A"))
    finally:
        for name, module in real.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
