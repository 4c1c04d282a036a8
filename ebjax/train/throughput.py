"""The task `throughput`: floor views a second in training, what the time goes into, and the same network in torch."""

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from ebjax.models.floornet import FloorNet
from ebjax.models.torch_networks import torch_network
from ebjax.train.canvas import SIDE_PX
from ebjax.train.floornet import Config as Training
from ebjax.train.floornet import objective, task
from ebjax.train.views import sample_pairs


@dataclasses.dataclass(frozen=True)
class Config:
    """Times a step of floornet's training."""

    training: Training = dataclasses.field(default_factory=Training)
    """The step that is timed."""
    turns: int = 5
    """Calls of each contender; the median counts."""


def _median(turns: int, *calls: Callable[[], Any]) -> list[float]:
    spent: list[list[float]] = [[] for _ in calls]
    for call in calls:
        jax.block_until_ready(call())
    for _ in range(turns):
        for taken, call in zip(spent, calls, strict=True):
            start = time.perf_counter()
            jax.block_until_ready(call())
            taken.append(time.perf_counter() - start)
    return [float(np.median(taken)) for taken in spent]


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Prints the figures; writes nothing."""
    training, root = config.training, jax.random.key(0)
    noise = np.random.default_rng(0).uniform(0.2, 0.6, (training.held_out + 7, SIDE_PX, SIDE_PX, 3))
    whole = task(training, noise.astype(np.float16))
    canvases = jnp.asarray(noise[: training.floors], jnp.float16)
    graph, *states = nnx.split(FloorNet(training.dimension, rngs=nnx.Rngs(0)), nnx.Param, ...)
    render = partial(sample_pairs, canvases, training.places, training.side_px, key=root)
    pairs = render()

    @jax.jit
    def forward(params, rest, pairs):
        network = nnx.merge(graph, params, rest, copy=True)
        parts = training.weights, training.temperatures, training.floors
        return objective(network, pairs, *parts, key=root, training=True)[0]

    @jax.jit
    @jax.grad
    def network_alone(params, rest, views):
        maps = nnx.merge(graph, params, rest, copy=True)(views, jnp.ones_like(views), training=True)
        return maps.places.sum() + maps.local.sum() + maps.score.sum()

    held = {"state": whole.state}

    def step():
        held["state"], metrics = whole.step(held["state"], 0)
        return metrics

    views = jnp.concatenate([pairs.first, pairs.second])
    calls: list[Callable[[], Any]] = [
        step,
        render,
        partial(forward, *states, pairs),
        partial(network_alone, *states, views),
    ]
    of_step, of_rendering, of_forward, ours = _median(config.turns, *calls)
    shares = of_rendering / of_step, of_forward / of_step
    print(
        f"{len(views) / of_step:.1f} floor views a second ({1e3 * of_step:.0f} ms a step of {len(views)}): "
        f"rendering {shares[0]:.0%}, forward {shares[1]:.0%}, backward and update {1 - sum(shares):.0%}"
    )
    try:
        theirs = torch_network("floornet").train()
    except ValueError as fault:
        print(f"not compared with torch: {fault}")
        return
    import torch

    tensor = torch.from_numpy(np.asarray(views)[:, None].copy())

    def torch_call() -> None:
        theirs.zero_grad()
        sum(part.sum() for part in theirs(tensor)).backward()

    (torch_s,) = _median(config.turns, torch_call)
    print(
        f"network alone, forward and backward: {1e3 * ours:.0f} ms, torch (norms folded) {1e3 * torch_s:.0f} ms, "
        f"{ours / torch_s:.2f} times its time"
    )
