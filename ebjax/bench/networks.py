"""Forward passes beside torch's, float32 channels last.

A figure is the median over turns, a ratio that of the medians. Run it on an otherwise idle machine, or on one core:
torch's threads suffer more from company than ours.
"""

import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Float

from ebjax.bench.turns import in_turn
from ebjax.models.catalogue import find, resolve
from ebjax.models.fast import accelerate
from ebjax.models.floornet import FloorNet
from ebjax.models.netvlad import Aggregation
from ebjax.models.resnet import fold
from ebjax.models.torch_networks import torch_network

SIZES = {
    "floornet": (200, 200, 1),
    "vgg16": (224, 224, 3),
    "resnet50": (224, 224, 3),
    "d2net": (400, 400, 3),
    "superpoint": (480, 640, 1),
    "netvlad-head": (30, 30, 512),
}
LARGE = ("d2net", "superpoint")
"""Their maps are so large that a batch is faster image by image (`jax.lax.map`)."""


@dataclass(frozen=True)
class NetworkConfig:
    """Times forward passes beside torch's, float32 channels last; prints a Markdown table."""

    networks: tuple[str, ...] = ("vgg16", "resnet50", "d2net", "superpoint", "netvlad-head")
    """Which ones."""
    batches: tuple[int, ...] = (1, 8)
    """Images a call."""
    turns: int = 9
    """Calls of each contender; the median counts."""
    one_core: bool = False
    """Stay on one core and count processor time: company on the machine then hardly disturbs."""


def bench_networks(config: NetworkConfig) -> None:
    """Prints one line a network and batch."""
    if unknown := [name for name in config.networks if name not in SIZES]:
        raise ValueError(f"no network {unknown[0]!r} to time; there are {', '.join(SIZES)}")
    if config.turns < 1 or not config.batches or min(config.batches) < 1:
        raise ValueError("--turns and --batches must be at least 1")
    if config.one_core:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])  # before JAX counts the cores
    rows = (row for name in config.networks for row in rows_of(name, config.batches, config.turns, config.one_core))
    for line in markdown(rows):
        print(line, flush=True)


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
      network: its name; `size` and `batch` are those of its input.
      torch_ms: median of torch.
      ours_ms: medians of "exact", "winograd" and "bfloat16".
      errors: of the latter two: largest deviation from the exact one over its largest value.
    """

    network: str
    size: tuple[int, int, int]
    batch: int
    torch_ms: float
    ours_ms: dict[str, float]
    errors: dict[str, float]


class _WholeViews(nnx.Module):
    """floornet on grey images all of which is floor."""

    def __init__(self, network: FloorNet):
        self.network = network

    def __call__(self, images: Float[Array, "B H W 1"]) -> Any:
        grey = images[..., 0]
        return self.network(grey, jnp.ones_like(grey))


def contenders(name: str) -> dict[str, Any]:
    """Our networks, stand-in weights: ResNet folded, as one would use it."""
    if name == "netvlad-head":
        exact: Any = Aggregation(rngs=nnx.Rngs(0))
    elif name == "floornet":
        exact = _WholeViews(FloorNet(rngs=nnx.Rngs(0)))
    else:
        exact = resolve(find(name).build)(None, rngs=nnx.Rngs(0))
    exact = fold(exact) if name == "resnet50" else exact
    return {"exact": exact, "winograd": accelerate(exact), "bfloat16": accelerate(exact, "bfloat16")}


def compiled(network: Any, images: Float[Array, "B H W C"], one_by_one: bool = False) -> Callable[[], Any]:
    """The forward pass of these images, compiled; one by one, the maps of an image stay in the cache."""
    graph, state = nnx.split(network)

    def run(state: Any, images: Array) -> Any:
        forward = nnx.merge(graph, state)
        if one_by_one:
            return jax.tree.map(lambda y: y[:, 0], jax.lax.map(lambda image: forward(image[None]), images))
        return forward(images)

    forward = jax.jit(run).lower(state, images).compile()
    return lambda: jax.block_until_ready(forward(state, images))


def rows_of(name: str, batches: tuple[int, ...], turns: int, one_core: bool = False) -> Iterator[Row]:
    """Yields a row for every batch.

    Args:
      name: of SIZES.
      batches: images a call.
      turns: calls of each contender.
      one_core: the process has one core; processor time counts, not the clock's.

    Raises:
      ValueError: torch is not installed.
    """
    theirs, ours = torch_network(name), contenders(name)
    import torch

    torch.set_num_threads(1 if one_core else torch.get_num_threads())
    clock = time.process_time if one_core else time.perf_counter
    for batch in batches:
        images = np.random.default_rng(0).uniform(size=(batch, *SIZES[name])).astype(np.float32)
        tensor = torch.from_numpy(images).permute(0, 3, 1, 2)

        def torch_call(tensor: Any = tensor) -> Any:
            with torch.inference_mode():
                return theirs(tensor)

        calls = {"torch": torch_call} | {
            key: compiled(net, jnp.asarray(images), name in LARGE) for key, net in ours.items()
        }
        results = {key: jax.tree.leaves(call()) for key, call in calls.items()}
        seconds = in_turn(calls, turns, clock=clock)
        median = {key: 1e3 * float(np.median(taken)) for key, taken in seconds.items()}
        errors = {key: _error(results["exact"], results[key]) for key in ("winograd", "bfloat16")}
        yield Row(name, SIZES[name], batch, median.pop("torch"), median, errors)


def _error(exact: list[Any], other: list[Any]) -> float:
    return max(float(jnp.abs(a - b).max() / jnp.abs(a).max()) for a, b in zip(exact, other, strict=True))


def markdown(rows: Iterable[Row]) -> Iterator[str]:
    """Lines of a table: medians in ms, in brackets the ratio to torch and the error."""
    yield "| network | input | batch | torch | ebjax | winograd | bfloat16 |"
    yield "|---|---|---|---|---|---|---|"
    for row in rows:
        cells = [row.network, "x".join(map(str, row.size)), str(row.batch), f"{row.torch_ms:.1f}"]
        for key, ms in row.ours_ms.items():
            error = f", {row.errors[key]:.0e}" if row.errors.get(key) else ""
            cells.append(f"{ms:.1f} ({ms / row.torch_ms:.2f}x{error})")
        yield f"| {' | '.join(cells)} |"
