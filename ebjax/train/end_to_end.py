"""The task `end_to_end`: the trajectory error itself tunes the camera's mounting, its lens and the aggregation.

On synthetic runs whose camera is not what it is believed, from an untuned vocabulary, Adam descends the ATE through
the whole pipeline (`ebjax.slam.soft`): the homography alone, the aggregation alone, and both; the lens if asked. The
table tells what each brings on other runs. Retrieval is asked again before every step.
"""

import dataclasses
import json
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from ebjax.floors.cameras import MODELS
from ebjax.floors.surface import FamilyName
from ebjax.geometry.camera import Camera
from ebjax.geometry.mount import Mounting
from ebjax.geometry.optics import Optics, unchanged
from ebjax.io.atomic import whole_file
from ebjax.slam.soft import Pairs, Parameters, Points, Softness, SoftRun, Words, ate_rmse_m, correct
from ebjax.slam.soft_look import DIMENSION, rootsift_look
from ebjax.slam.soft_pairs import choose_pairs, choose_points
from ebjax.train.end_to_end_runs import WorldConfig, corridor, load_run
from ebjax.train.loop import SCORE, LoopConfig, Task, fit
from ebjax.views.run_view import choose_floor

BEST = "parameters.npz"
TUNED = {
    "homography": ("camera",),
    "aggregation": ("words", "threshold"),
    "both": ("camera", "words", "threshold"),
    "lens": ("lens",),
    "all": ("camera", "lens", "words", "threshold"),
}
KINDS = {"mounting": "camera", "coefficients": "lens", "threshold": "threshold"}
"""Of the parameters, by what their path says; all others are words."""
Part = Literal["homography", "aggregation", "both", "lens", "all"]


@dataclasses.dataclass(frozen=True)
class Config:
    """Tunes camera and aggregation by the trajectory error of synthetic runs, and tells what each brings on others."""

    seed: int = 0
    """Of the worlds and of the untuned vocabulary."""
    training: tuple[FamilyName, ...] = ("glazed", "marble", "terrazzo")
    """Floors of the runs that tune."""
    held_out: tuple[FamilyName, ...] = ("slabs", "concrete", "wood")
    """Floors of the runs that tell."""
    world: WorldConfig = dataclasses.field(default_factory=WorldConfig)
    parts: tuple[Part, ...] = ("homography", "aggregation", "both")
    """What is tuned, one after the other, each from the start: lens and all need a camera with a lens."""
    pitch_deg: float = 3.0
    """What is wrong with the camera's pitch at first, degrees."""
    roll_deg: float = 1.0
    """... with its roll, degrees."""
    height_m: float = 0.05
    """... with its height, m."""
    distortion_off: float = 0.0
    """... with the first coefficient of its lens, as a share of it."""
    clusters: int = 16
    """Of the vocabulary."""
    candidates: int = 2
    """Pairs that each view takes part in as the later one."""
    gap_s: float = 5.0
    """A view is compared with views at least so much earlier, s."""
    gap_m: float = 4.0
    """... and, in the same direction, at least so much path earlier, m."""
    metres_per_px: float = 0.02
    """Of the floor view."""
    loop: LoopConfig = dataclasses.field(default_factory=lambda: LoopConfig(steps=30, validate_every=5))
    camera_rate: float = 0.01
    """Of Adam at first, rad and m; rates fall to nothing as a cosine."""
    lens_rate: float = 0.01
    """... for the coefficients of the lens."""
    words_rate: float = 0.01
    """... for centres, assignment and bias."""
    threshold_rate: float = 0.05
    """... for the distance at which a loop is believed by half."""


def untuned(clusters: int, seed: int) -> Words:
    """A vocabulary of random orthogonal centres and assignments, as an untrained network has."""
    first, second = jax.random.split(jax.random.key(seed))
    initial = jax.nn.initializers.orthogonal()
    centres = initial(first, (clusters, DIMENSION), jnp.float32)
    assignment = 10 * initial(second, (DIMENSION, clusters), jnp.float32)
    return Words(centres, assignment, jnp.zeros(clusters, jnp.float32), jnp.asarray(0.5, jnp.float32))


def mounting(pitch_deg: float | int, roll_deg: float | int, height_m: float | int) -> Mounting:
    """Degrees and metres."""
    return Mounting(*(jnp.asarray(v, float) for v in (np.radians(pitch_deg), np.radians(roll_deg), height_m)))


def optimiser(config: Config, part: str) -> optax.GradientTransformation:
    """Adam, a rate for each kind of parameter, none for what is not tuned."""
    rates = {
        "camera": config.camera_rate,
        "lens": config.lens_rate,
        "words": config.words_rate,
        "threshold": config.threshold_rate,
    }
    kinds: dict[Any, optax.GradientTransformation] = {
        kind: optax.adam(optax.cosine_decay_schedule(rate, config.loop.steps))
        if kind in TUNED[part]
        else optax.set_to_zero()
        for kind, rate in rates.items()
    }

    def kind(path: Any, _: Any) -> str:
        name = jax.tree_util.keystr(path)
        if "intrinsics" in name:
            return "kept"
        return next((kind for part, kind in KINDS.items() if part in name), "words")

    kinds["kept"] = optax.set_to_zero()
    return optax.multi_transform(kinds, lambda parameters: jax.tree_util.tree_map_with_path(kind, parameters))


@partial(jax.jit, static_argnames="softness")
@jax.value_and_grad
def _descend(
    parameters: Parameters, run: SoftRun, points: Points, pairs: Pairs, softness: Softness
) -> Float[Array, ""]:
    return ate_rmse_m(correct(parameters, run, points, pairs, softness).poses, run.truth)


def chosen(parameters: Parameters, run: SoftRun, softness: Softness, config: Config) -> tuple[Points, Pairs]:
    """What retrieval says for the parameters of the moment."""
    points = choose_points(parameters, run, softness)
    gaps = {"gap_s": config.gap_s, "gap_m": config.gap_m}
    return points, choose_pairs(parameters, run, points, softness, candidates=config.candidates, **gaps)


def tune(
    part: str, start: Parameters, runs: list[SoftRun], softness: Softness, config: Config, out: Path, *, resume: bool
) -> Parameters:
    """The best parameters on the way down the mean ATE of the runs, only a part of them moving.

    Args:
      part: of `TUNED`.
      start: where to begin.
      runs: that tune.
      softness: see there.
      config: see there.
      out: folder of the log, the checkpoints and the parameters.
      resume: go on from the latest checkpoint there.

    Raises:
      ValueError, OSError: as `loop.fit`.
    """
    adam = optimiser(config, part)
    update = jax.jit(adam.update)
    first, shape = jax.tree.flatten((start, adam.init(start)))

    def step(leaves: list[Array], number: int) -> tuple[list[Array], dict[str, float]]:
        del number
        parameters, memory = jax.tree.unflatten(shape, leaves)
        found = [_descend(parameters, run, *chosen(parameters, run, softness, config), softness) for run in runs]
        mean = jax.tree.map(lambda *slopes: sum(slopes) / len(slopes), *(slope for _, slope in found))
        change, memory = update(mean, memory, parameters)
        metrics = {"loss": float(np.mean([error for error, _ in found])), **_told(parameters)}
        return jax.tree.leaves((optax.apply_updates(parameters, change), memory)), metrics

    def validate(leaves: list[Array]) -> dict[str, float]:
        parameters, _ = jax.tree.unflatten(shape, leaves)
        return {SCORE: -float(np.mean(errors_m(parameters, runs, softness, config)))}

    def export(leaves: list[Array], metrics: dict[str, Any], folder: Path) -> None:
        del metrics
        with whole_file(folder / BEST, "wb") as file:
            np.savez(file, *(np.asarray(leaf) for leaf in leaves))

    settings = {**dataclasses.asdict(config), "part": part}
    fit(Task(first, step, validate, export, settings), config.loop, out, resume=resume)
    with open(out / BEST, "rb") as file, np.load(file) as kept:
        return jax.tree.unflatten(shape, [jnp.asarray(kept[name]) for name in kept.files])[0]


def _told(parameters: Parameters) -> dict[str, float]:
    camera, lens = parameters.mounting, {}
    if parameters.optics is not None:
        lens = {"first_coefficient": float(parameters.optics.coefficients[0])}
    return lens | {
        "pitch_deg": float(jnp.degrees(camera.pitch_rad)),
        "roll_deg": float(jnp.degrees(camera.roll_rad)),
        "height_m": float(camera.height_m),
        "threshold": float(parameters.words.threshold),
    }


def errors_m(parameters: Parameters, runs: list[SoftRun], softness: Softness, config: Config) -> list[float]:
    """ATE rmse of every run, m."""
    found = (correct(parameters, run, *chosen(parameters, run, softness, config), softness) for run in runs)
    return [float(ate_rmse_m(one.poses, run.truth)) for one, run in zip(found, runs, strict=True)]


def run(config: Config, out: Path, *, resume: bool) -> None:
    """Tunes, tests, prints the table and writes it: table.md, metrics.json, and a folder for each part's training.

    Args:
      config: see there.
      out: folder of the results and of the rendered runs.
      resume: go on with the parts that are begun.

    Raises:
      ValueError: a world or a camera that cannot be, or another training in `out`; names the key.
      OSError: `out` cannot be written.
    """
    wrong, off = mounting(config.pitch_deg, config.roll_deg, config.height_m), config.distortion_off
    check(config)
    runs = {
        name: [
            load_run(corridor(config.world, family, config.seed + 1 + first + k), wrong, out / "runs", off)
            for k, family in enumerate(families)
        ]
        for name, first, families in (("training", 0, config.training), ("held out", 100, config.held_out))
    }
    floor = choose_floor(runs["training"][0].camera, config.metres_per_px)
    softness = Softness(floor, rootsift_look(config.metres_per_px), exact=False, rtol=1e-16)
    camera = runs["training"][0].camera
    bends = camera.lens.model != "pinhole"
    optics = unchanged(camera) if bends else None
    start = Parameters(mounting(0, 0, 0), untuned(config.clusters, config.seed), optics=optics)
    right = dataclasses.replace(
        start,
        mounting=mounting(-config.pitch_deg, -config.roll_deg, -config.height_m),
        optics=corrected(camera, off) if bends else None,
    )

    def measured(parameters: Parameters) -> dict[str, Any]:
        found = {name: errors_m(parameters, some, softness, config) for name, some in runs.items()}
        return {"ate_rmse_m": found, "parameters": _told(parameters)}

    odometry = {name: [float(ate_rmse_m(jnp.asarray(r.chain.poses), r.truth)) for r in rs] for name, rs in runs.items()}
    rows = {"odometry": {"ate_rmse_m": odometry}, "before": measured(start)}
    for part in config.parts:
        print(f"tuning: {part}")
        rows[part] = measured(tune(part, start, runs["training"], softness, config, out / part, resume=resume))
    rows["true camera, untuned aggregation"] = measured(right)
    lines = table(rows, config)
    with whole_file(out / "metrics.json") as file:
        json.dump({"config": dataclasses.asdict(config), "rows": rows}, file, indent=1)
    with whole_file(out / "table.md") as file:
        file.write("\n".join(lines) + "\n")
    print("\n".join(lines))


def check(config: Config) -> None:
    """Raises ValueError that names a key which asks for a lens where the camera has none."""
    bends = MODELS[config.world.camera].distortion_model != "pinhole"
    if not bends and (config.distortion_off or {"lens", "all"} & set(config.parts)):
        key = "distortion_off" if config.distortion_off else "parts"
        raise ValueError(f"{key} asks for a lens, but world.camera {config.world.camera} has none: set phone-raw")


def corrected(camera: Camera, off: float) -> Optics:
    """What undoes `off`, a share of the first coefficient, of a camera that is believed so."""
    none = unchanged(camera)
    first = jnp.asarray(camera.lens.coefficients)[0]
    return dataclasses.replace(none, coefficients=none.coefficients.at[0].set(-first * off / (1 + off)))


def table(rows: dict[str, Any], config: Config) -> list[str]:
    """Markdown: ATE on the held-out runs, before and after."""
    head = ["tuned", *config.held_out, "mean", "of before", "training mean", "pitch, roll (deg), height (m) left"]
    lines = [
        "ATE rmse on the held-out runs, SE(2)-aligned, m.",
        "",
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
    ]
    before = np.mean(rows["before"]["ate_rmse_m"]["held out"])
    for name, row in rows.items():
        errors, seen = row["ate_rmse_m"]["held out"], row["ate_rmse_m"]["training"]
        cells = [name, *(f"{e:.3f}" for e in errors), f"{np.mean(errors):.3f}", f"{np.mean(errors) / before:.2f}"]
        cells.append(f"{np.mean(seen):.3f}")
        if told := row.get("parameters"):
            wrong = config.pitch_deg, config.roll_deg, config.height_m
            left = [a + b for a, b in zip(wrong, (told[k] for k in ("pitch_deg", "roll_deg", "height_m")), strict=True)]
            cells.append(f"{left[0]:+.2f}, {left[1]:+.2f}, {left[2]:+.3f}")
            if (first := told.get("first_coefficient")) is not None:
                cells[-1] += f"; first coefficient {first:+.3f}"
        else:
            cells.append("")
        lines.append("| " + " | ".join(cells) + " |")
    return lines
