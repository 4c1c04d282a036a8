"""`python -m ebjax.paper tables`: every table and figure of the paper, one folder."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ebjax.paper import drift, page, published, worlds
from ebjax.paper.experiment import Experiment
from ebjax.paper.retrieval import BOTH
from ebjax.paper.run import METRES_PER_PX, STEP_DEG, STEP_M

QUICK_PAIRS, FULL_PAIRS = 1, 4


def real_data(data: Path | None, name: str) -> Path | None:
    """A set of real data in the folder given, or in $EBJAX_DATA; None where it is not."""
    folder = data if data is not None else Path(os.environ["EBJAX_DATA"]) if "EBJAX_DATA" in os.environ else None
    return folder / name if folder is not None and (folder / name).is_dir() else None


def make(
    out: Path,
    sets: tuple[str, ...],
    plans: tuple[str, ...],
    folder: Path | None,
    data: Path | None,
    weights: Path | None,
    *,
    quick: bool,
    seed: int,
) -> list[str]:
    """Measures whatever `out` does not hold yet, draws and writes; see `ebjax.paper.__main__.TablesConfig`.

    Returns:
      the lines of the tables.

    Raises:
      ValueError: a world that is not there or not understood, or real data that cannot be read.
      OSError: `out` cannot be written.
    """
    folder = worlds.default_folder() if folder is None else folder
    pairs = QUICK_PAIRS if quick else FULL_PAIRS
    experiment = Experiment(out, folder, quick=quick, pairs=pairs, weights=weights, seed=seed)
    for name in (*sets, *plans):
        experiment.config(name)
    real, d5 = real_data(data, "opposing_pairs"), real_data(data, "d5_pose_graph")
    experiment.recall(sets)
    experiment.correspondences(sets, real)
    experiment.trajectories(plans, d5)
    drawn = experiment.draw(sets, plans)
    sections = list(_sections(experiment, sets, plans, real, d5))
    sections.append(("## Figures", [line for caption, path in drawn for line in page.shown(caption, path, out)]))
    settings = _settings(experiment, sets, plans)
    page.write(out, sections, {**experiment.tables, "settings": settings, "left_out": experiment.left_out})
    for path in experiment.cells.damaged:
        print(f"{path}: damaged; measured again")
    print(f"{experiment.cells.measured} cells measured, {experiment.cells.reused} found")
    return [line for title, lines in sections[:-1] for line in (title, "", *lines)]


def _settings(experiment: Experiment, sets: tuple[str, ...], plans: tuple[str, ...]) -> dict[str, Any]:
    return {
        "quick": experiment.quick,
        "seed": experiment.seed,
        "pairs_a_set": experiment.pair_count,
        "looked_at_every_m": STEP_M,
        "looked_at_every_deg": STEP_DEG,
        "floor_view_metres_per_px": METRES_PER_PX,
        "pipeline": repr(experiment.pipeline),
        "false_closure": f"more than {drift.FALSE_M} m or {drift.FALSE_DEG} degrees off the truth",
        "worlds": {name: worlds.settings(experiment.config(name), name) for name in (*sets, *plans)},
    }


def _sections(
    experiment: Experiment, sets: tuple[str, ...], plans: tuple[str, ...], real: Path | None, d5: Path | None
) -> Iterator[tuple[str, list[str]]]:
    tables = experiment.tables
    cut = f"frames {worlds.QUICK_STEP_M:g} m apart, straight ways out cut to {worlds.QUICK_WAY_M:g} m"
    quick = f"Quick: {cut}, {experiment.pair_count} pair a set. " if experiment.quick else ""
    yield (
        "# The experiments of Early Bird, measured",
        [
            f"{quick}Seed {experiment.seed}. Worlds are rendered from {', '.join((*sets, *plans))}.yaml; tables.json "
            "has every setting. Queries are the frames of the way back, references those of the way out.",
            "Truth is the floor: robots that face each other, the centres of whose floor views lie within the radius.",
            published.SOURCE,
            "",
        ],
    )
    if sets:
        title = "## Table 1: raw images, floor views, and R_pi"
        yield title, [*page.recall_tables(tables["table 1"], sets, published.RECALL_OF_INPUTS)]
        title = f"## Table 2: descriptors, floor + pi (joint: {BOTH})"
        yield title, [*page.recall_tables(tables["table 2"], sets, published.RECALL_OF_DESCRIPTORS)]
    if sets or real is not None:
        absent = [] if real is not None else ["No real pairs: give --data, or set EBJAX_DATA.", ""]
        lead = ["Mean inliers / matches, and pairs whose motion is right.", ""]
        yield "## Table 3: local features", [*lead, *page.pair_table(tables["table 3"]), *absent]
    if plans or d5 is not None:
        absent = [] if d5 is not None else ["No graph of D5: give --data, or set EBJAX_DATA.", ""]
        lead = [f"ATE rmse, SE(2)-aligned. False: more than {drift.FALSE_M} m or {drift.FALSE_DEG:g} degrees off.", ""]
        yield "## Table 4: trajectories", [*lead, *page.drift_table(tables["table 4"]), *absent]
    if experiment.left_out:
        yield "## Left out", [*(f"- {name}: {reason}" for name, reason in experiment.left_out.items()), ""]
