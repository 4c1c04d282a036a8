"""The tasks `places` and `features`: floornet learns both at once, or with other weights of its losses one of them.

A step takes a canvas of each of several families and looks at some places of it from both sides (`views`). Which
canvases and which looks those are depends on the seed and the step's number alone.
"""

import dataclasses
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from jaxtyping import Array, Float, Key

from ebjax.models.floornet import CELL, FloorMaps, FloorNet
from ebjax.models.weights import flat_arrays, load_into, load_weights, save_weights
from ebjax.train import processes
from ebjax.train.canvas import NAMES, make_canvases
from ebjax.train.loop import LoopConfig, Task, fit
from ebjax.train.loop import check as check_loop
from ebjax.train.losses import (
    choose_points,
    correlations,
    correspondences,
    cross_entropy,
    dense_loss,
    first_is_best,
    local_loss,
    without_common,
)
from ebjax.train.photograph import Wild
from ebjax.train.views import Pairs, sample_pairs

WEIGHTS = "floornet.safetensors"
SEEN_SHARE = 0.8
DENSE_POINTS, LOCAL_POINTS = 16, 64


@dataclasses.dataclass(frozen=True)
class Weights:
    """Of the losses."""

    places: float = 1.0
    """Opposing views of a place correlate best."""
    dense: float = 0.5
    """Cells of the place map find themselves among those of all views."""
    local: float = 1.0
    """Local descriptors find themselves in the opposing view."""
    score: float = 0.2
    """Scores tell which local descriptors do."""


@dataclasses.dataclass(frozen=True)
class Temperatures:
    """Of the softmax in each loss."""

    places: float = 0.04
    dense: float = 0.07
    local: float = 0.06


@dataclasses.dataclass(frozen=True)
class Config:
    """Trains floornet on synthetic floors."""

    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    canvases: int = 224
    """Synthetic floors, families in turn."""
    held_out: int = 28
    """How many of them, the first, are kept for validation."""
    floors: int = 7
    """Canvases in a step, each of another family as far as there are any."""
    places: int = 4
    """Of each canvas in a step, at most 9."""
    side_px: int = 160
    """Of a view, a multiple of 8."""
    wild: Wild = dataclasses.field(default_factory=Wild)
    rate: float = 2e-3
    """Largest learning rate of AdamW; it rises over `warmup` steps and falls along a cosine."""
    warmup: int = 30
    """Steps."""
    decay: float = 1e-4
    """Of the weights."""
    dimension: int = 64
    """Of descriptors."""
    weights: Weights = dataclasses.field(default_factory=Weights)
    temperatures: Temperatures = dataclasses.field(default_factory=Temperatures)
    start: Path | None = None
    """Weights to begin with; None: random."""
    seed: int = 0
    """Of floors, views and first weights."""


def check(config: Config) -> None:
    """Raises ValueError that names the key which no training can have."""
    check_loop(config.loop)
    if not 1 <= config.places <= 9:
        raise ValueError(f"places is {config.places}: needs 1 to 9 of a canvas")
    if config.side_px < 4 * CELL or config.side_px % CELL:
        raise ValueError(f"side_px is {config.side_px}: needs a multiple of {CELL}, at least {4 * CELL}")
    if config.dimension < 2 or config.dimension % 2:
        raise ValueError(f"dimension is {config.dimension}: needs an even number")
    if not 1 <= config.floors <= config.held_out:
        raise ValueError(f"floors is {config.floors}: needs 1 to held_out, {config.held_out}")
    if config.canvases < config.held_out + max(config.floors, len(NAMES)):
        raise ValueError(
            f"canvases is {config.canvases}: needs at least {max(config.floors, len(NAMES))} over held_out"
        )
    for name in ("mirrors", "rest"):
        if not 0 <= getattr(config.wild, name) <= 1:
            raise ValueError(f"wild.{name} is {getattr(config.wild, name)}: needs a share from 0 to 1")
    if not config.rate > 0:
        raise ValueError(f"rate is {config.rate}: needs a value above 0")


def forward(network: FloorNet, pairs: Pairs, *, training: bool) -> FloorMaps:
    """The maps of all first views, then of all second ones."""
    fields = [jnp.broadcast_to(seen, pairs.first.shape) for seen in (pairs.seen_first, pairs.seen_second)]
    return network(jnp.concatenate([pairs.first, pairs.second]), jnp.concatenate(fields), training=training)


def objective(
    network: FloorNet,
    pairs: Pairs,
    weights: Weights,
    temperatures: Temperatures,
    floors: int,
    *,
    key: Key[Array, ""],
    training: bool,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """The weighted sum of the losses, and what it is made of.

    Args:
      network: is told the statistics of the batch in training.
      pairs: places, floor by floor.
      weights: of the losses.
      temperatures: of their softmax.
      floors: how many: what all views of a floor share does not count.
      key: of the points that are looked at.
      training: whether the batch normalises itself.
    """
    maps, count = forward(network, pairs, training=training), len(pairs.first)

    def halves(values: Array) -> tuple[Array, Array]:
        return values[:count], values[count:]

    masks = _cells(pairs.seen_first), _cells(pairs.seen_second)
    first, second = without_common(*halves(maps.places), masks, floors)
    scores = correlations(first, second, masks)
    every = jnp.ones_like(scores, dtype=bool)
    places = cross_entropy(scores / temperatures.places, every, every[0])
    points = choose_points(pairs.first, pairs.seen_first, LOCAL_POINTS, key=key)
    there, valid = correspondences(points, pairs.second_from_first, pairs.seen_second)
    few = (points[:, :DENSE_POINTS], there[:, :DENSE_POINTS]), valid[:, :DENSE_POINTS]
    dense = dense_loss(first, second, *few, temperatures.dense)
    at = points, there
    local, score, right = local_loss(*halves(maps.local), halves(maps.score), at, valid, temperatures.local)
    loss = weights.places * places + weights.dense * dense + weights.local * local + weights.score * score
    return loss, {
        "loss": loss,
        "places": places,
        "dense": dense,
        "local": local,
        "score loss": score,
        "R@1": first_is_best(scores),
        "right": right,
    }


def _parts(config: Config) -> tuple[Weights, Temperatures, int]:
    return config.weights, config.temperatures, config.floors


def _cells(seen: Float[Array, "S S"]) -> Float[Array, "s s"]:
    cells = seen.shape[0] // CELL
    return (seen.reshape(cells, CELL, cells, CELL).mean((1, 3)) > SEEN_SHARE).astype(seen.dtype)


def _optimiser(config: Config) -> optax.GradientTransformation:
    steps = config.loop.steps
    rate = optax.warmup_cosine_decay_schedule(0, config.rate, min(config.warmup, steps // 3), steps, 0.01 * config.rate)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=config.decay))


@partial(jax.jit, static_argnames=("graph", "config"), donate_argnums=0)
def _step(state: dict[str, Any], canvases: Float[Array, "C h w 3"], graph: Any, config: Config, *, key: Key[Array, ""]):
    view_key, point_key = jax.random.split(key)
    pairs = jax.lax.stop_gradient(sample_pairs(canvases, config.places, config.side_px, config.wild, key=view_key))

    def loss(params, rest):
        network = nnx.merge(graph, params, rest, copy=True)
        value, metrics = objective(network, pairs, *_parts(config), key=point_key, training=True)
        return value, (metrics, nnx.state(network, nnx.Not(nnx.Param)))

    (_, (metrics, rest)), gradient = jax.value_and_grad(loss, has_aux=True)(state["params"], state["rest"])
    update, optimiser = _optimiser(config).update(gradient, state["optimiser"], state["params"])
    params = optax.apply_updates(state["params"], update)
    metrics["gradient"] = optax.tree.norm(gradient)
    return processes.kept_whole({"params": params, "rest": rest, "optimiser": optimiser}), metrics


@partial(jax.jit, static_argnames=("graph", "config"))
def _validate(
    state: dict[str, Any], canvases: Float[Array, "C h w 3"], graph: Any, config: Config, *, key: Key[Array, ""]
):
    view_key, point_key = jax.random.split(key)
    pairs = sample_pairs(canvases, config.places, config.side_px, config.wild, key=view_key)
    network = nnx.merge(graph, state["params"], state["rest"])
    return objective(network, pairs, *_parts(config), key=point_key, training=False)[1]


def save_network(network: FloorNet, metrics: Mapping[str, float | int], path: Path) -> None:
    """Writes the weights, float16, with the metrics in the file's header."""
    half = {name: np.asarray(array, np.float16) for name, array in flat_arrays(network).items()}
    save_weights(path, "floornet", half, {name: f"{value:.6g}" for name, value in metrics.items()})


def task(config: Config, canvases: Float[np.ndarray, "N h w 3"]) -> Task:
    """The training of a network on canvases, the first `held_out` of which are for validation."""
    network = FloorNet(config.dimension, rngs=nnx.Rngs(config.seed))
    if config.start is not None:
        load_into(network, load_weights(config.start)[1])
    graph, *states = nnx.split(network, nnx.Param, ...)
    params, rest = states
    root, held_root = jax.random.split(jax.random.key(config.seed))

    def step(state, number):
        rng = np.random.default_rng([config.seed, number])
        rows = config.held_out + _of_families(rng, len(canvases) - config.held_out, config.floors)
        chosen = processes.share(canvases[rows])
        return _step(state, chosen, graph, config, key=jax.random.fold_in(root, number))

    def validate(state):
        found = []
        for k in range(config.held_out // config.floors):
            some = processes.share(canvases[k * config.floors : (k + 1) * config.floors])
            found.append(_validate(state, some, graph, config, key=jax.random.fold_in(held_root, k)))
        mean = {name: float(np.mean([float(one[name]) for one in found])) for name in found[0]}
        return {**mean, "score": -mean["loss"]}

    def export(state, metrics, out):
        save_network(nnx.merge(graph, state["params"], state["rest"]), metrics, out / WEIGHTS)

    settings = {name: value for name, value in dataclasses.asdict(config).items() if name != "loop"}
    state = {"params": params, "rest": rest, "optimiser": _optimiser(config).init(params)}
    return Task(state, step, validate, export, settings)


def _of_families(rng: np.random.Generator, count: int, floors: int) -> np.ndarray:
    """Rows of canvases of as many different families as there are; canvas k is of family k mod their number."""
    families = np.concatenate([rng.permutation(len(NAMES)) for _ in range(-(-floors // len(NAMES)))])[:floors]
    return np.array([rng.choice(np.arange(family, count, len(NAMES))) for family in families])


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Trains; writes floornet.safetensors (the best of all validations) beside log and checkpoints."""
    check(config)
    processes.check_rows(config.floors, "floors")
    canvases = processes.in_turn(lambda: make_canvases(config.canvases, out / "canvases.npy", seed=config.seed))
    fit(task(config, canvases), config.loop, out, resume=resume)
