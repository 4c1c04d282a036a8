"""The task `finetune`: floornet learns the floor of one's own run, taught by the closures that slam accepted there.

The corrected trajectory says which earlier view faces each later one and how the two lie on each other. Part of the
floor, along the path, is held out: nothing is learned from it, and what was gained is measured there.
"""

import dataclasses
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import nnx
from jaxtyping import Array, Bool, Float, Int, Key, UInt8

from ebjax.command import progress
from ebjax.geometry.camera import camera_from
from ebjax.io.atomic import whole_file
from ebjax.io.frames import Frames
from ebjax.io.sequence import require_odometry
from ebjax.mapping.open_run import camera_source, open_run
from ebjax.models.eye import Eye
from ebjax.models.floornet import FloorNet, fitted, open_floornet
from ebjax.models.luma import luma
from ebjax.places.fixed_words import save_words, words_path
from ebjax.places.floornet import keep, unite
from ebjax.places.learn_words import learn_words
from ebjax.places.recall import facing_pairs, precision_100, recall_at_1
from ebjax.places.retrieve import comparable
from ebjax.places.search import search
from ebjax.posegraph.init import to_matrices
from ebjax.slam.config import PipelineConfig
from ebjax.slam.pipeline import run as run_pipeline
from ebjax.slam.recording import Recording
from ebjax.slam.run import Run
from ebjax.slam.world import planar
from ebjax.train.floornet import WEIGHTS, Temperatures, Weights, objective, save_network
from ebjax.train.loop import LoopConfig, Task, fit
from ebjax.train.own_run import OwnRun
from ebjax.train.views import Pairs
from ebjax.train.words import turn_of
from ebjax.views.run_view import RunView, choose_floor, from_camera

METRES_PER_PX = 0.01
MIN_CLOSURES = 6
WORD_CELLS = 60_000
"""Cells of the run's views that words are learned from, at most."""
NEAR_CLOSURE_M = 2.0
"""Pairs farther than this from every accepted closure are not believed."""


@dataclasses.dataclass(frozen=True)
class Config(OwnRun):
    """Trains floornet further on a run of one's own."""

    loop: LoopConfig = dataclasses.field(default_factory=lambda: LoopConfig(steps=200, validate_every=20, patience=4))
    start: Path | None = None
    """Weights to begin with; None: those that come with ebjax."""
    slam: PipelineConfig = dataclasses.field(default_factory=PipelineConfig)
    """How the closures are found that teach."""
    held_out: float = 1 / 3
    """Share of the floor, the end of the way out, that is for validation."""
    pairs: int = 12
    """Places in a step, spread along the path."""
    reach_m: float = 0.6
    """Largest distance of the centres of two facing views that are taken for a pair, m."""
    rate: float = 3e-4
    """Learning rate of AdamW."""
    weights: Weights = dataclasses.field(default_factory=Weights)
    temperatures: Temperatures = dataclasses.field(default_factory=Temperatures)
    seed: int = 0
    """Of the choice of pairs."""


@dataclasses.dataclass(frozen=True)
class Taught:
    """A run as it teaches: its views, and pairs of them that show the same floor from opposite sides.

    Attributes:
      views: grey floor views of all keyframes, in [0, 1].
      seen: the field of view.
      poses: corrected, of all keyframes.
      later: row of each pair's later view.
      earlier: row of the earlier one.
      turned_from_later: pixels of the earlier view, turned by pi, from those of the later one.
      along_m: where each pair lies, as the way of the earlier view from the start.
    """

    views: Float[np.ndarray, "K h w"]
    seen: Float[np.ndarray, "h w"]
    poses: Float[np.ndarray, "K 3"]
    later: Int[np.ndarray, " P"]
    earlier: Int[np.ndarray, " P"]
    turned_from_later: Float[np.ndarray, "P 3 3"]
    along_m: Float[np.ndarray, " P"]


def taught(result: Run, view: RunView, reach_m: float) -> Taught:
    """What the accepted closures of a run say about pairs of its views.

    Raises:
      ValueError: too few closures were accepted.
    """
    kept = result.kept
    if kept.sum() < MIN_CLOSURES:
        raise ValueError(f"slam accepts {int(kept.sum())} closures on this run; to learn from it takes {MIN_CLOSURES}")
    poses = result.poses[result.keyframes]
    centres = np.einsum("nij,j->ni", to_matrices(poses), np.append(view.centre_m, 1.0))[:, :2]
    row = {int(frame): k for k, frame in enumerate(result.keyframes)}
    trusted = centres[[row[int(frame)] for frame in result.candidates.i[kept]]]
    near = np.linalg.norm(centres[:, None] - trusted[None], axis=-1).min(1) <= NEAR_CLOSURE_M
    later, earlier = np.nonzero(facing_pairs(poses, view.centre_m, reach_m) & near[:, None])

    fit_views = jax.jit(jax.vmap(partial(_fit, seen=np.asarray(view.seen))))
    views = np.asarray(fit_views(jnp.asarray(seen_views(result))))
    seen = np.asarray(fitted(jnp.zeros(view.seen.shape, jnp.float32), jnp.asarray(view.seen, jnp.float32))[1])
    height, width = seen.shape
    stretch = np.array([width / view.seen.shape[1], height / view.seen.shape[0]])
    fitted_from_view = np.diag([*stretch, 1.0])
    fitted_from_view[:2, 2] = (stretch - 1) / 2
    floor_from_fitted = np.asarray(view.floor_from_view) @ np.linalg.inv(fitted_from_view)
    turned = np.array([[-1.0, 0, width - 1], [0, -1, height - 1], [0, 0, 1]])
    moved = np.linalg.inv(to_matrices(poses[earlier])) @ to_matrices(poses[later])
    warp = turned @ np.linalg.inv(floor_from_fitted) @ moved @ floor_from_fitted
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))])
    return Taught(views, seen, poses, later, earlier, warp, travelled[earlier])


def seen_views(result: Run) -> UInt8[np.ndarray, "K h w 3"]:
    """The floor views of all keyframes."""
    return np.stack([result.seen(k) for k in range(len(result.keyframes))])


def _fit(view, seen):
    return fitted(luma(view.astype(jnp.float32) / 255), jnp.asarray(seen, jnp.float32))[0]


def comb(along_m: Float[np.ndarray, " P"], count: int, rng: np.random.Generator) -> Int[np.ndarray, " C"]:
    """One pair from each of `count` equal parts of the path: places of a step lie apart.

    Args:
      along_m: where the pairs lie.
      count: of the parts.
      rng: chooses among the pairs nearest to the middle of each part, and where parts begin.
    """
    low, high = along_m.min(), along_m.max()
    width = (high - low) / count
    targets = low + (np.arange(count) + rng.uniform()) * width
    noisy = np.abs(along_m[None, :] - targets[:, None]) + 0.25 * width * rng.uniform(size=(count, len(along_m)))
    return np.argmin(noisy, axis=1)


def batch(run: Taught, rows: Int[np.ndarray, " N"]) -> Pairs:
    """Some pairs as `objective` takes them."""
    second = run.views[run.earlier[rows]][:, ::-1, ::-1]
    arrays = (run.views[run.later[rows]], second, run.seen, run.seen[::-1, ::-1], run.turned_from_later[rows])
    return Pairs(*(jnp.asarray(array, jnp.float32) for array in arrays))


@partial(jax.jit, static_argnames=("graph", "config"), donate_argnums=0)
def _step(state: dict[str, Any], pairs: Pairs, graph: Any, config: Config, *, key: Key[Array, ""]):
    def loss(params):
        network = nnx.merge(graph, params, state["rest"])
        return objective(network, pairs, config.weights, config.temperatures, 1, key=key, training=False)

    (_, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(state["params"])
    update, optimiser = _optimiser(config).update(gradient, state["optimiser"], state["params"])
    return {**state, "params": optax.apply_updates(state["params"], update), "optimiser": optimiser}, metrics


@partial(jax.jit, static_argnames=("graph", "config"))
def _validate(state: dict[str, Any], pairs: Pairs, graph: Any, config: Config, *, key: Key[Array, ""]):
    network = nnx.merge(graph, state["params"], state["rest"])
    return objective(network, pairs, config.weights, config.temperatures, 1, key=key, training=False)[1]


def _optimiser(config: Config) -> optax.GradientTransformation:
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(config.rate, weight_decay=1e-4))


def kept_of(network: FloorNet, result: Run) -> list[Mapping[str, Array]]:
    """What the descriptor keeps of every keyframe's view."""
    eye = Eye(network)
    rows = ((result.seen(k), result.floor(k)) for k in range(len(result.keyframes)))
    return [keep(eye(jnp.asarray(v, jnp.float32) / 255, jnp.asarray(s))) for v, s in rows]


def write_words(network: FloorNet, weights: Path, result: Run, seed: int) -> None:
    """Learns the words of these weights from the run's own views, and writes them beside the weights."""
    cells = np.concatenate([np.asarray(one["map"])[np.asarray(one["cells"])] for one in kept_of(network, result)])
    few = np.random.default_rng(seed).permutation(len(cells))[:WORD_CELLS]
    turn = turn_of("floornet", cells.shape[1])
    words = learn_words(jnp.asarray(cells[few], jnp.float32), turn, key=jax.random.key(seed))
    save_words(words_path("floornet", weights.parent), "floornet", words, weights)


def recall(
    network: FloorNet, result: Run, truth: Float[np.ndarray, "K 3"], view: RunView, asked: Bool[np.ndarray, " K"]
) -> dict[str, float]:
    """R@0.3 m, R@1 m and P100 of some keyframes, searched as slam does."""
    kept = kept_of(network, result)
    places = unite({name: np.stack([np.asarray(one[name]) for one in kept]) for name in kept[0]})
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=1))])
    order = np.arange(len(truth), dtype=float)
    allowed = comparable(jnp.asarray(order), jnp.asarray(travelled), 0.0, PipelineConfig().min_gap_m)
    ranked = jax.tree.map(np.asarray, search(places, allowed))
    first = np.where(ranked.valid[:, 0], ranked.j[:, 0], -1)
    found: dict[str, float] = {}
    for radius in (0.3, 1.0):
        pairs = facing_pairs(truth, view.centre_m, radius) & asked[:, None]
        share, queries = recall_at_1(first, ranked.opposing[:, 0], pairs)
        found |= {f"R@{radius:g} m": -1.0 if share is None else share, f"queries {radius:g} m": float(queries)}
    right = pairs[np.arange(len(first)), np.maximum(first, 0)] & ranked.opposing[:, 0]
    of = pairs.any(1)
    return found | {"P100": precision_100(-ranked.distance[of, 0].astype(np.float64), right[of])}


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Trains on a run; writes floornet.safetensors, its words and finetune.json, and prints what was gained where."""
    if not 0 < config.held_out < 1:
        raise ValueError(f"held_out is {config.held_out}: needs a share between 0 and 1")
    sequence = open_run(config)
    for note in sequence.notes:
        print(note)
    camera, frames = camera_from(sequence.camera), Frames(sequence)
    try:
        view = from_camera(camera, choose_floor(camera, METRES_PER_PX))
    except ValueError as fault:
        raise ValueError(f"{camera_source(config, sequence)}: {fault}") from None

    odometry = planar(require_odometry(sequence, "fine-tuning"))
    result = run_pipeline(
        Recording(frames.both, sequence.timestamps, odometry), camera, view, config.slam, progress=progress
    )
    lesson = taught(result, view, config.reach_m)
    apart_m = view.extent_m / 2  # places that overlap more would be each other's rivals
    border = np.quantile(lesson.along_m, 1 - config.held_out)
    learn = np.flatnonzero(lesson.along_m < border - apart_m)
    hold = np.flatnonzero(lesson.along_m >= border)
    count = min(config.pairs, int(np.ptp(lesson.along_m[learn]) / apart_m)) if len(learn) else 0
    if count < 3 or len(hold) < 2:
        raise ValueError(f"{sequence.path}: its accepted closures lie too close together to hold some floor out")
    path, network = open_floornet(config.start)
    graph, *states = nnx.split(network, nnx.Param, ...)
    root = jax.random.key(config.seed)
    few = max(2, int(np.ptp(lesson.along_m[hold]) / apart_m))
    held = batch(lesson, hold[comb(lesson.along_m[hold], few, np.random.default_rng(config.seed))])

    def step(state, number):
        rows = learn[comb(lesson.along_m[learn], count, np.random.default_rng([config.seed, number]))]
        return _step(state, batch(lesson, rows), graph, config, key=jax.random.fold_in(root, number))

    def validate(state):
        metrics = {name: float(value) for name, value in _validate(state, held, graph, config, key=root).items()}
        return {**metrics, "score": -metrics["loss"]}

    def export(state, metrics, out):
        save_network(nnx.merge(graph, state["params"], state["rest"]), metrics, out / WEIGHTS)

    named = {"sequence": str(config.sequence), "camera": str(config.camera), "start": str(path)}
    settings = {**named, "rate": config.rate, "seed": config.seed}
    state = {"params": states[0], "rest": states[1], "optimiser": _optimiser(config).init(states[0])}
    export(state, {"step": 0}, out)
    fit(Task(state, step, validate, export, settings), config.loop, out, resume=resume)

    known = sequence.world_from_base
    truth = lesson.poses if known is None else planar(known)[result.keyframes]
    asked = np.isin(np.arange(len(lesson.poses)), lesson.later[hold])
    networks = {"before": open_floornet(config.start)[1], "after": open_floornet(out / WEIGHTS)[1]}
    write_words(networks["after"], out / WEIGHTS, result, config.seed)
    rows = {name: recall(one, result, truth, view, asked) for name, one in networks.items()}
    by = "the corrected path" if known is None else "ground truth"
    print(f"held-out floor, {int(asked.sum())} views, right by {by}:")
    for name, row in rows.items():
        print(f"{name:7s} " + "  ".join(f"{key} {value:.3f}" for key, value in row.items()))
    with whole_file(out / "finetune.json") as text:
        json.dump({"closures": int(result.kept.sum()), "right by": by, **rows}, text, indent=1)
