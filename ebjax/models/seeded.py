"""Stand-in checkpoints from a seed: untrained, but every layer matters and anybody gets the same bits.

Each tensor has its own generator, numpy's default_rng([seed, crc32("network/key")]); a draw is an integer
floor(2^24 u) - 2^23 with u uniform float32, everything after it exact in float64 and rounded to float32 once.
The keys, their order, shapes and layouts are those of the published files.
"""

import hashlib
import math
import zlib
from collections.abc import Mapping

import numpy as np

from ebjax.models.resnet import BLOCKS
from ebjax.models.vgg import STAGES, torchvision_indices

HALF = 2**23
CLUSTERS, CHANNELS, COMPONENTS = 64, 512, 128
AVERAGE_RGB = (123.68, 116.779, 103.939)
SUPERPOINT = {
    "conv1a": (64, 1),
    "conv1b": (64, 64),
    "conv2a": (64, 64),
    "conv2b": (64, 64),
    "conv3a": (128, 64),
    "conv3b": (128, 128),
    "conv4a": (128, 128),
    "conv4b": (128, 128),
    "convPa": (256, 128),
}


class _Draws:
    """The tensors of one network, by key."""

    def __init__(self, network: str, seed: int):
        self.network, self.seed = network, seed
        self.state: dict[str, np.ndarray] = {}

    def integers(self, key: str, shape: tuple[int, ...]) -> np.ndarray:
        generator = np.random.default_rng([self.seed, zlib.crc32(f"{self.network}/{key}".encode())])
        return (generator.random(shape, np.float32) * np.float32(2 * HALF)).astype(np.int64) - HALF

    def uniform(self, key: str, shape: tuple[int, ...], low: float, high: float) -> np.ndarray:
        draws = self.integers(key, shape)
        return ((low + high) / 2 + draws * ((high - low) / (2.0 * HALF))).astype(np.float32)

    def filters(self, key: str, shape: tuple[int, ...], gain: float, zero_sum: bool) -> np.ndarray:
        """Uniform with variance gain / fan-in; `zero_sum` takes every filter's mean away."""
        draws, fan_in = self.integers(key, shape), math.prod(shape[1:])
        unit = math.sqrt(gain / fan_in) * math.sqrt(12.0) / (2.0 * HALF)
        if not zero_sum:
            return (draws * unit).astype(np.float32)
        sums = draws.sum(tuple(range(1, len(shape))), keepdims=True)
        return ((draws * fan_in - sums) * (unit / fan_in)).astype(np.float32)

    def convolution(
        self, name: str, out: int, inputs: int, size: int = 3, gain: float = 3.0, zero_sum: bool = True, bias=True
    ) -> None:
        weight = f"{name}.weight"
        self.state[weight] = self.filters(weight, (out, inputs, size, size), gain, zero_sum)
        if bias:
            self.state[f"{name}.bias"] = self.uniform(f"{name}.bias", (out,), -0.1, 0.1)

    def norm(self, name: str, channels: int, scale: tuple[float, float] = (0.6, 1.4)) -> None:
        ranges = {"weight": scale, "bias": (-0.2, 0.2), "running_mean": (-0.2, 0.2), "running_var": (0.5, 1.5)}
        for part, (low, high) in ranges.items():
            self.state[f"{name}.{part}"] = self.uniform(f"{name}.{part}", (channels,), low, high)
        self.state[f"{name}.num_batches_tracked"] = np.array(1, np.int64)

    def linear(self, name: str, out: int, inputs: int) -> None:
        bound = math.sqrt(6.0 / inputs)
        self.state[f"{name}.weight"] = self.uniform(f"{name}.weight", (out, inputs), -bound, bound)
        self.state[f"{name}.bias"] = self.uniform(f"{name}.bias", (out,), -0.1, 0.1)

    def stack(self, prefix: str, network: str, input_scale: float, stages: int = 5) -> None:
        for index, out, inputs, gain in _stack(network, input_scale, stages):
            self.convolution(f"{prefix}{index}", out, inputs, gain=gain, zero_sum=inputs != 3)


def _stack(network: str, input_scale: float, stages: int = 5):
    inputs = 3
    for index, name in torchvision_indices(STAGES[network][:stages]).items():
        out = min(64 * 2 ** (int(name[4]) - 1), 512)
        yield index, out, inputs, 2.0 * input_scale**2 if inputs == 3 else 3.0
        inputs = out


def _superpoint(draws: _Draws) -> None:
    for name, (out, inputs) in SUPERPOINT.items():
        draws.convolution(name, out, inputs, gain=8.0 if inputs == 1 else 4.0, zero_sum=inputs != 1)
    draws.convolution("convPb", 65, 256, 1, gain=1.2)
    draws.state["convPb.bias"][64] = 8.5
    draws.convolution("convDa", 256, 128, gain=4.0)
    draws.convolution("convDb", 256, 256, 1)


def _resnet50(draws: _Draws) -> None:
    draws.convolution("conv1", 64, 3, 7, gain=2.0, zero_sum=False, bias=False)
    draws.norm("bn1", 64)
    inputs = 64
    for stage, count in enumerate(BLOCKS, 1):
        width = 32 * 2**stage
        for n in range(count):
            block = f"layer{stage}.{n}"
            for part, shape in enumerate(((width, inputs, 1), (width, width, 3), (4 * width, width, 1)), 1):
                draws.convolution(f"{block}.conv{part}", *shape, bias=False)
                draws.norm(f"{block}.bn{part}", shape[0], (0.05, 0.25) if part == 3 else (0.6, 1.4))
            if n == 0:
                draws.convolution(f"{block}.downsample.0", 4 * width, inputs, 1, gain=2.0, bias=False)
                draws.norm(f"{block}.downsample.1", 4 * width)
            inputs = 4 * width


def _vocabulary(draws: _Draws, centroids: str, assignment: str) -> tuple[np.ndarray, np.ndarray]:
    """Centroids and assignment weights, clusters x channels, of about the same directions."""
    shape, unit = (CLUSTERS, CHANNELS), math.sqrt(3.0 / CHANNELS) / HALF
    shared = 4 * draws.integers("centroid directions", shape)
    own, other = shared + draws.integers(centroids, shape), shared + draws.integers(assignment, shape)
    return (own * (0.6 * unit / 4)).astype(np.float32), (other * (60.0 * unit / 4)).astype(np.float32)


def _netvlad_nanne(draws: _Draws) -> None:
    draws.stack("encoder.", "vgg16", 1.0)
    centroids, assignment = _vocabulary(draws, "pool.centroids", "pool.conv.weight")
    draws.state["pool.centroids"] = centroids
    draws.state["pool.conv.weight"] = assignment[:, :, None, None]


def _netvlad_wpca(draws: _Draws) -> None:
    _netvlad_nanne(draws)
    shape, bound = (COMPONENTS, CLUSTERS * CHANNELS, 1, 1), math.sqrt(3.0)
    draws.state["WPCA.0.weight"] = draws.uniform("WPCA.0.weight", shape, -bound, bound)
    draws.state["WPCA.0.bias"] = draws.uniform("WPCA.0.bias", shape[:1], -0.3, 0.3)


def _netvlad_mat(draws: _Draws) -> None:
    """MATLAB's layouts: height, width, in, out; the centroids negated."""
    state = draws.state
    for index, out, inputs, gain in _stack("vgg16", 1 / 64):
        key = f"layers.{index}.weights"
        filters = draws.filters(f"{key}.0", (out, inputs, 3, 3), gain, inputs != 3)
        state[f"{key}.0"] = np.ascontiguousarray(filters.transpose(2, 3, 1, 0))
        state[f"{key}.1"] = draws.uniform(f"{key}.1", (1, out), -0.1, 0.1)
    centroids, assignment = _vocabulary(draws, "layers.30.weights.1", "layers.30.weights.0")
    state["layers.30.weights.0"] = np.ascontiguousarray(assignment.T)[None, None]
    state["layers.30.weights.1"] = np.ascontiguousarray(-centroids.T)[None, None]
    bound, key = math.sqrt(3.0), "layers.33.weights"
    state[f"{key}.0"] = draws.uniform(f"{key}.0", (1, 1, CLUSTERS * CHANNELS, COMPONENTS), -bound, bound)
    state[f"{key}.1"] = draws.uniform(f"{key}.1", (COMPONENTS, 1), -0.3, 0.3)
    state["meta.normalization.averageImage"] = np.tile(np.array(AVERAGE_RGB, np.float32), (224, 224, 1))


MAKERS = {
    "d2net": lambda draws: draws.stack("dense_feature_extraction.model.", "vgg16", 1 / 64, stages=4),
    "superpoint": _superpoint,
    "netvlad_nanne": _netvlad_nanne,
    "netvlad_wpca": _netvlad_wpca,
    "netvlad_mat": _netvlad_mat,
    "vgg16": lambda draws: draws.stack("features.", "vgg16", 1.0),
    "vgg19": lambda draws: draws.stack("features.", "vgg19", 1.0),
    "resnet50": _resnet50,
}


def seeded_state(network: str, seed: int, *, head: bool = True) -> dict[str, np.ndarray]:
    """A full set of published keys for one of MAKERS.

    Args:
      network: netvlad_wpca has the same tensors as netvlad_nanne, and the whitening.
      seed: not negative.
      head: with the classifier of VGG and ResNet; leaving it out changes no other tensor.
    """
    draws = _Draws({"netvlad_wpca": "netvlad_nanne"}.get(network, network), seed)
    MAKERS[network](draws)
    if head and network in STAGES:
        for layer, shape in {0: (4096, 25088), 3: (4096, 4096), 6: (1000, 4096)}.items():
            draws.linear(f"classifier.{layer}", *shape)
    elif head and network == "resnet50":
        draws.linear("fc", 1000, 2048)
    return draws.state


def digest(state: Mapping[str, np.ndarray]) -> str:
    """SHA-256 over every key, dtype, shape and byte, in order; a number counts as an array of one."""
    total = hashlib.sha256()
    for key, array in state.items():
        array = np.atleast_1d(array)
        total.update(f"{key}|{array.dtype.str}|{array.shape}|".encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()
