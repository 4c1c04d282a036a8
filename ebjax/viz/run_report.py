"""A run's report.html: what is in its folder, in pictures, tables and words."""

from collections.abc import Sequence as Listed
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ebjax.evaluation.run import closure_errors, spread_rows
from ebjax.io.sequence import Sequence
from ebjax.slam.believe import THINNED
from ebjax.slam.recording import Load
from ebjax.slam.run import Run
from ebjax.slam.world import planar
from ebjax.viz import figures
from ebjax.viz.candidate_figures import candidate_figures
from ebjax.viz.report import report
from ebjax.viz.run_metrics import best_row
from ebjax.viz.run_page import Pictures, run_page

SHOWN, SHOWN_REFUSED = 3, 2
"""Closures, and candidates that were not believed, that are shown in pictures."""


def write_report(
    folder: Path, sequence: Sequence, load: Load, result: Run, metrics: dict[str, Any], made: Listed[list[str]]
) -> None:
    """Writes report.html.

    Args:
      folder: holds all other files of the run.
      sequence: what was run.
      load: frame number -> (RGB, depth), or None.
      result: of the pipeline.
      metrics: what metrics.json holds.
      made: how the run was made, rows of a name and a value.
    """
    candidates, kept = result.candidates, result.kept
    chosen = np.flatnonzero(kept)
    pairs = np.stack([candidates.j, candidates.i], 1)

    def shown(rows: Int[np.ndarray, " n"]) -> list[dict[str, Any]]:
        return [figure for k in rows.tolist() for figure in candidate_figures(sequence, load, result, k)]

    page = run_page(
        sequence.path.resolve().name,
        metrics,
        Pictures(
            trajectory=(folder / "trajectory.png").read_bytes(),
            floor_map=(folder / "floor_map.png").read_bytes(),
            candidates=figures.candidates(pairs, 1 - candidates.distance, kept, len(sequence)),
            closures=shown(spread_rows(chosen, SHOWN)),
            refused=shown(_refused(result)),
        ),
        closure_rows(sequence, result, chosen),
        made,
        sorted(file.name for file in folder.iterdir()),
    )
    (folder / "report.html").write_text(report(page), encoding="utf-8")


def _refused(result: Run) -> Int[np.ndarray, " n"]:
    """Rows of candidates that look alike and were not believed; where none was, the best one."""
    best = best_row(result)
    if best is not None and not result.kept.any():
        return np.array([best])
    alike = ~result.kept & (result.candidates.inliers >= 12) & ~np.isin(result.reasons, [THINNED])
    return spread_rows(np.flatnonzero(alike), SHOWN_REFUSED)


def closure_rows(sequence: Sequence, result: Run, rows: Int[np.ndarray, " n"]) -> list[list[Any]]:
    """Kept closures as the report's table shows them; with their errors, m and degrees, where the truth is known."""
    found, errors = result.candidates.rows(rows), _errors(sequence, result, rows)
    table: list[list[Any]] = []
    for k in range(len(rows)):
        x, y, turn = map(float, found.i_from_j[k])
        side = "opposite" if found.opposing[k] else "same"
        names = sequence.names[found.i[k]], sequence.names[found.j[k]]
        counts = int(found.inliers[k]), int(found.total[k])
        table.append([*names, side, *counts, x, y, float(np.degrees(np.arctan2(np.sin(turn), np.cos(turn))))])
        if errors is not None:
            table[-1] += [float(errors[k, 0]), float(np.degrees(errors[k, 1]))]
    return table


def _errors(sequence: Sequence, result: Run, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"] | None:
    if sequence.world_from_base is None:
        return None
    truth, found = planar(sequence.world_from_base), result.candidates.rows(rows)
    return closure_errors(truth[found.i], truth[found.j], found.i_from_j)
