"""`python -m ebjax.paper ablations`: what the result depends on, a table and a figure each."""

from dataclasses import asdict
from pathlib import Path

from ebjax.paper import page, worlds
from ebjax.paper.ablations import FIGURES, QUICK, Ablations, Scale, measure_all
from ebjax.paper.experiment import Experiment


def make(out: Path, *, quick: bool, seed: int) -> list[str]:
    """Measures, draws and writes the ablations; see `ebjax.paper.__main__.AblationsConfig`.

    Returns:
      the lines of the tables.
    """
    scale = QUICK if quick else Scale()
    experiment = Experiment(out, worlds.default_folder(), quick=quick, pairs=0, weights=None, seed=seed)
    found, drawn = measure_all(Ablations(experiment, scale), out)
    lines = []
    for name, points in found.items():
        setting, _ = FIGURES[name]
        keys = list(dict.fromkeys(key for series in points.values() for point in series.values() for key in point))
        lines += [f"## {setting[0].upper()}{setting[1:]}", ""]
        rows = {
            f"{series}, {value}" if series else value: [page.number(point.get(key)) for key in keys]
            for series, values in points.items()
            for value, point in values.items()
        }
        lines += [*page.markdown_table([setting, *keys], rows)]
    shown = [line for caption, path in drawn for line in page.shown(caption, path, out)]
    page.write_ablations(out, [*lines, *shown], {**found, "settings": {"quick": quick, "seed": seed, **asdict(scale)}})
    return lines
