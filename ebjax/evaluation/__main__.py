"""Measures a trajectory against a reference: ATE and RPE, by time, by row or along the path.

Files with times are associated by time, one to one; times in other units than seconds are converted, an offset of the
clocks is named. Files without (KITTI) are associated by row, if they have as many rows, and by arc length beside it.
Every alignment is printed: none, SE(2), SE(3), Sim(3); one that the positions do not determine is named undefined.

    python -m ebjax.evaluation TRAJECTORY REFERENCE         ATE and RPE
    python -m ebjax.evaluation nees RUN --reference FILE    whether a run's errors are as large as its covariances say
"""

import json
import sys
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


if __name__ == "__main__":
    if sys.argv[1:2] == ["nees"]:
        run(nees, NeesConfig, sys.argv[2:])
    else:
        run(main, EvaluationConfig, needs_jax=False)
