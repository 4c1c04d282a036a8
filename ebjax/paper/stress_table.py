"""`python -m ebjax.paper stress`: descriptors on clean and corrupted floor views of several runs, in one table."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ebjax.floors import corrupt
from ebjax.io.atomic import whole_file
from ebjax.paper import page
from ebjax.paper.run import read_run
from ebjax.paper.stress import BOTH, CLEAN, FACING, MERITS, Views, corrupted, floor_views, measure
from ebjax.places.descriptor import descriptor
from ebjax.viz import experiments

CORRUPTED, MEAN = "corrupted", "mean"
R_NEAR, R_FAR, P100 = MERITS
TITLES = {R_NEAR: "R@0.3 m", R_FAR: "R@1 m", P100: "P100"}
COLUMNS = tuple(
    (searched, condition, merit)
    for searched, shown in ((FACING, MERITS), (BOTH, (R_FAR, P100)))
    for condition in (CLEAN, CORRUPTED)
    for merit in shown
)
SHOWN = 3

Found = Mapping[str, Mapping[str, Mapping[str, Mapping[str, Any]]]]


def make(
    paths: Sequence[Path], out: Path, names: Sequence[str], weights: Path | None, strength: float, seeds: int
) -> list[str]:
    """Measures, writes stress.md, stress.json and stress.png; see `ebjax.paper.__main__.StressConfig`.

    Returns:
      the lines of the tables.

    Raises:
      ValueError: no seed; two runs of one name; a run without truth; a descriptor that does not fit; names it.
    """
    if seeds < 1 or strength < 0:
        raise ValueError(f"--seeds is {seeds}, --strength {strength:g}; give at least 1 and at least 0")
    if len({path.resolve().name for path in paths}) < len(paths):
        raise ValueError(f"two of {', '.join(map(str, paths))} have the same name, by which tables tell them apart")
    if "joint" in names:
        raise ValueError("descriptor 'joint' looks at the whole image, of which floor views tell nothing; leave it out")
    methods = {name: descriptor(name, weights) for name in names}
    runs = {path.resolve().name: read_run(path) for path in paths}
    found: dict[str, Found] = {}
    pictures: dict[str, list[UInt8[np.ndarray, "_ _ 3"]]] = {}
    for name, run in runs.items():
        clean = floor_views(run)
        found[name] = measure(run, clean, methods, strength, seeds)
        pictures[name] = _examples(clean, strength)
    lines = table(found)
    settings = {"strength": strength, "seeds": seeds, "corruption": limits()}
    with whole_file(out / "stress.json") as file:
        json.dump({"settings": settings, "runs": found, "mean": _means(found)}, file, indent=1, allow_nan=False)
    with whole_file(out / "stress.png", "wb") as file:
        file.write(experiments.image_grid(pictures, (CLEAN, CORRUPTED) * SHOWN))
    head = f"Strength {strength:g}, mean of {seeds} corruptions of every view."
    with whole_file(out / "stress.md") as file:
        text = ["# Retrieval on corrupted floor views", "", head, "", *lines, "![floor views](stress.png)", ""]
        file.write("\n".join(text))
    return [head, "", *lines]


def limits() -> dict[str, Any]:
    """The constants of `ebjax.floors.corrupt`."""
    return {name.lower(): value for name, value in vars(corrupt).items() if name.isupper()}


def table(found: Mapping[str, Found]) -> list[str]:
    """A table a method, in per cent, a row a run; P100 is a share of all frames of the way back."""
    lines = []
    head = [f"{TITLES[merit]}, {searched}, {condition}" for searched, condition, merit in COLUMNS]
    for method, means in _means(found).items():
        rows = {}
        for name, cells in found.items():
            values = _averaged(cells[method])
            number = cells[method][CLEAN][FACING][f"{R_FAR}_queries"]
            rows[f"{name} ({number} queries)"] = [page.percent(values[column]) for column in COLUMNS]
        if len(rows) > 1:
            rows[MEAN] = [page.percent(means[" ".join(column)]) for column in COLUMNS]
        lines += [f"**{method}**", "", *page.markdown_table(["%", *head], rows)]
    return lines


def _averaged(cells: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[tuple[str, str, str], float | None]:
    """The columns of one method on one run, corruptions averaged; None where the run asks nothing."""
    values = {}
    for searched, condition, merit in COLUMNS:
        part = [cell[searched][merit] for key, cell in cells.items() if (key == CLEAN) == (condition == CLEAN)]
        values[searched, condition, merit] = None if None in part else float(np.mean(part))
    return values


def _means(found: Mapping[str, Found]) -> dict[str, dict[str, float | None]]:
    """Method -> column -> mean over the runs that ask something."""
    means: dict[str, dict[str, float | None]] = {}
    for method in next(iter(found.values())):
        runs = [_averaged(cells[method]) for cells in found.values()]
        known = {column: [value for run in runs if (value := run[column]) is not None] for column in COLUMNS}
        means[method] = {" ".join(c): float(np.mean(v)) if v else None for c, v in known.items()}
    return means


def _examples(clean: Views, strength: float) -> list[UInt8[np.ndarray, "_ _ 3"]]:
    chosen = np.linspace(0, len(clean[0]) - 1, SHOWN + 2).round().astype(int)[1:-1]
    some = clean[0][chosen], clean[1][chosen]
    pairs = zip(some[0], corrupted(some, strength, seed=0)[0], strict=True)
    return [np.rint(255 * view).astype(np.uint8) for pair in pairs for view in pair]
