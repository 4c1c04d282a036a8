"""Measures a trajectory against a reference: ATE and RPE, by time, by row or along the path; repeats the paper.

Files with times are associated by time, one to one; times in other units than seconds are converted, an offset of the
clocks is named. Files without (KITTI) are associated by row, if they have as many rows, and by arc length beside it.
Every alignment is printed: none, SE(2), SE(3), Sim(3); one that the positions do not determine is named undefined.

    python -m ebjax.evaluation TRAJECTORY REFERENCE         ATE and RPE
    python -m ebjax.evaluation nees RUN --reference FILE    whether a run's errors are as large as its covariances say
    python -m ebjax.evaluation paper                        the paper's tables and figures
    python -m ebjax.evaluation crops FLOORS                 descriptors on crops of photographed floors
    python -m ebjax.evaluation ablations                    what recall and trajectory depend on
    python -m ebjax.evaluation stress RUNS                  descriptors on corrupted floor views
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from ebjax.command import run
from ebjax.evaluation.compare import EvaluationConfig, evaluate, report
from ebjax.evaluation.nees import between, summaries, table, tangent_errors
from ebjax.evaluation.nees_tables import read_measurements
from ebjax.io.atomic import whole_file


def main(config: EvaluationConfig) -> None:
    """Prints the errors and, with --out, writes metrics.json."""
    metrics = evaluate(config)
    print(report(metrics, config))
    if config.out is not None:
        with whole_file(Path(config.out) / "metrics.json") as file:
            json.dump(metrics, file, indent=1)
            file.write("\n")


@dataclass(frozen=True)
class NeesConfig:
    """Tells whether the errors of a run are as large as its covariances say: NEES of steps, closures, relative poses.

    The mean should be 3. Above the interval the covariances are too small, below too large. Rows that the run did not
    use are left out, no other. Pairs of relative poses overlap, so their mean strays further than the interval says.
    """

    run: tyro.conf.Positional[Path]
    """Folder that python -m ebjax.slam wrote."""
    reference: str
    """The true poses of the base, z up: a file with times, such as groundtruth.txt."""
    distances: tuple[float, ...] = (1.0, 5.0, 20.0)
    """Path lengths of the relative poses, m."""
    pairs: int = 40
    """Relative poses a distance, at most."""
    max_time_difference_s: float = 0.02
    """How far the nearest true pose may be in time, s, where it lies not between two samples at most 0.5 s apart."""
    out: Path | None = None
    """Folder for nees.json; none is written without it."""


def nees(config: NeesConfig) -> None:
    """Prints the table and what was left out; with --out, writes nees.json."""
    if not config.distances or min(config.distances) <= 0 or config.pairs < 1:
        raise ValueError("--distances and --pairs must be positive")
    from ebjax.viz.run_errors import frames_and_truth, relative_errors, scale_sigma

    times, truth, notes = frames_and_truth(config.run, config.reference, config.max_time_difference_s)
    notes += [f"truth for {np.isfinite(truth).all(1).sum()} of {len(truth)} frames"]
    results: dict[str, Any] = {}
    for name, table_file, flag, groups in (
        ("steps", "steps.csv", "used", ("gap", "kind")),
        ("closures", "loop_closures.csv", "kept", ()),
    ):
        path = config.run / table_file
        if name == "steps" and not path.exists():
            notes.append(f"{path}: not there; the steps are left out")
            continue
        rows = read_measurements(path, flag, times, groups)
        error = tangent_errors(rows.i_from_j, between(truth[rows.i], truth[rows.j]))
        results[name] = summaries(error, rows.covariance, rows.labels)
        known = int(np.isfinite(error).all(1).sum())
        notes.append(f"{path}: {rows.rows} rows, {len(error)} {flag}, {known} of them with truth")
        if not known:
            notes[-1] += f"; the {name} are left out"
    scale = scale_sigma(config.run)
    relative = relative_errors(config.run, truth, config.distances, config.pairs, scale)
    results["relative"] = {name: values for name, values in relative.items() if values}
    notes.append(f"relative poses: the graph's marginals, and a scale known to {100 * scale:.3f} % (metrics.json)")
    notes += [f"relative, {name}: no two frames with truth are that far apart" for name, v in relative.items() if not v]
    print("\n".join([*table(results), *notes]))
    if config.out is not None:
        with whole_file(config.out / "nees.json") as file:
            json.dump(
                {"run": str(config.run), "reference": config.reference, **results, "notes": notes}, file, indent=1
            )
            file.write("\n")


@dataclass(frozen=True)
class PaperConfig:
    """Repeats the paper's tables and figures on synthetic worlds, and on real data where there is any.

    Writes paper.md, tables.json and PNGs. What OUT holds already is not measured again.
    """

    out: Path = Path("runs/paper")
    """Folder for the results, the rendered worlds among them."""
    quick: bool = False
    """Fewer frames, straight ways cut short, one pair a set."""
    sets: tuple[str, ...] = ("D1", "D2", "D3", "D4", "D5", "D6", "D7")
    """Worlds of tables 1 to 3."""
    plans: tuple[str, ...] = ("S1", "S2", "S3")
    """Worlds of table 4."""
    worlds: Path | None = None
    """Folder with NAME.yaml for every world; None: configs/worlds of the checkout."""
    data: Path | None = None
    """Folder of real data, opposing_pairs and d5_pose_graph in it; None: $EBJAX_DATA."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    seed: int = 0
    """Of vocabularies and RANSAC."""


@dataclass(frozen=True)
class AblationsConfig:
    """Measures what recall and trajectory depend on: length of the way, floor, lateral shift, closures, kernel.

    Writes ablations.md, ablations.json and a PNG each. What OUT holds already is not measured again.
    """

    out: Path = Path("runs/ablations")
    """Folder for the results, the rendered worlds among them."""
    quick: bool = False
    """Shorter ways, fewer frames, fewer values of every setting."""
    seed: int = 0
    """Of the worlds, vocabularies and RANSAC."""


@dataclass(frozen=True)
class CropsConfig:
    """Ranks descriptors by retrieval among crops of photographed floors, and of synthetic floors beside them.

    Local features match some of the crops with what is seen of them again. Writes crops.md, crops.json and PNGs of
    examples; prints Kendall's tau of the two rankings.
    """

    floors: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of photographs of floors, or of facing pairs with gt.json."""
    out: Path = Path("runs/crops")
    """Folder for the results."""
    only: str = "*"
    """Images that count, as a pattern of their names."""
    crops: int = 800
    """Crops in the database, at most."""
    pairs: int = 60
    """Crops that local features match with their queries, at most."""
    synthetic: bool = True
    """Measure on synthetic floors too."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""
    seed: int = 0
    """Of viewpoints, light, synthetic floors and vocabularies."""


@dataclass(frozen=True)
class StressConfig:
    """Measures descriptors by retrieval on the floor views of runs there and back, clean and corrupted.

    Every view is corrupted by itself: rotation, scale, blur, gamma, a hard shadow, a saturated spot, noise. Writes
    stress.md, stress.json and stress.png.
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of runs there and back, with ground truth for every frame."""
    out: Path = Path("runs/stress")
    """Folder for the results."""
    descriptors: tuple[str, ...] = ("rootsift-vlad",)
    """Global descriptors that look at floor views."""
    strength: float = 1.0
    """Of all corruptions; 0 corrupts nothing."""
    seeds: int = 3
    """How often every view is corrupted anew."""
    weights: Path | None = None
    """Folder of the networks' weights; None: $EBJAX_WEIGHTS or ~/.cache/ebjax/weights."""


def ablations(config: AblationsConfig) -> None:
    """Measures, draws, writes, prints the tables."""
    from ebjax.paper.ablation_table import make

    print("\n".join(make(config.out, quick=config.quick, seed=config.seed)))
    print(f"wrote {config.out / 'ablations.md'}")


def crops(config: CropsConfig) -> None:
    """Measures, writes, prints the table."""
    from ebjax.paper.crop_table import make

    common = (config.only, config.crops, config.weights, config.seed)
    print("\n".join(make(config.floors, config.out, *common, pairs=config.pairs, side_by_side=config.synthetic)))
    print(f"wrote {config.out / 'crops.md'}")


def paper(config: PaperConfig) -> None:
    """Measures, draws, writes, prints the tables."""
    from ebjax.paper.command import make

    lines = make(
        config.out,
        config.sets,
        config.plans,
        config.worlds,
        config.data,
        config.weights,
        quick=config.quick,
        seed=config.seed,
    )
    print("\n".join(lines))
    print(f"wrote {config.out / 'paper.md'}")


def stress(config: StressConfig) -> None:
    """Measures, writes, prints the tables."""
    from ebjax.paper.stress_table import make

    common = (config.descriptors, config.weights, config.strength, config.seeds)
    print("\n".join(make(config.runs, config.out, *common)))
    print(f"wrote {config.out / 'stress.md'}")


COMMANDS: dict[str, tuple[Callable[[Any], None], type]] = {
    "nees": (nees, NeesConfig),
    "paper": (paper, PaperConfig),
    "ablations": (ablations, AblationsConfig),
    "crops": (crops, CropsConfig),
    "stress": (stress, StressConfig),
}


if __name__ == "__main__":
    if sys.argv[1:2] and sys.argv[1] in COMMANDS:
        run(*COMMANDS[sys.argv[1]], sys.argv[2:])
    else:
        run(main, EvaluationConfig, needs_jax=False)
