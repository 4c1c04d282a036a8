"""paper.md and tables.json: what was measured, beside what the paper says."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ebjax.io.atomic import whole_file
from ebjax.paper import published

DASH = "–"
Rows = dict[str, list[str]]
RECALLS = {
    "paper_recall": "paper_recall: within a fifteenth of the whole path, %",
    "one_way_recall": "within a fifteenth of one way, %",
    "recall_at_1_1m": "R@1 m, %",
    "p100_1m": "P100: share of the way back accepted at 100 % precision (1 m), %",
}


def markdown_table(head: Sequence[str], rows: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Lines of a table: the first column is the rows' names."""
    yield "| " + " | ".join(head) + " |"
    yield "|---" * len(head) + "|"
    for name, cells in rows.items():
        yield f"| {name} | " + " | ".join(cells) + " |"
    yield ""


def percent(value: float | int | None) -> str:
    """A share as per cent."""
    return DASH if value is None else f"{100 * value:.1f}"


def shown(caption: str, path: Path, out: Path) -> list[str]:
    """A picture in `out` with its caption."""
    return [f"![{caption}]({path.relative_to(out)})", "", caption, ""]


def reason(why: ValueError | str) -> str:
    """Why a row is left out, the first clause of it: where weights should lie is not for a table."""
    text = str(why).partition(", and")[0]
    return f"{text} (python -m ebjax.models list)" if text.endswith("needs weights") else text


def beside(quoted: published.Table, columns: Sequence[str], text_of: Callable[[float | int], str]) -> Rows:
    """The paper's rows under ours; none where it has none of the columns."""
    return {
        f"the paper's {row}": [text_of(cells[name]) if name in cells else DASH for name in columns]
        for row, cells in quoted.items()
        if any(name in cells for name in columns)
    }


def recall_tables(
    table: Mapping[str, Mapping[str, Mapping[str, Any]]], sets: Sequence[str], quoted: published.Table
) -> Iterator[str]:
    """One table a metric, the paper's own under its metric; by chance: a blind guess among the way out's frames."""
    for metric, title in RECALLS.items():
        yield f"**{title}**"
        yield ""
        rows: Rows = {
            row: [percent(cells[name][metric]) if name in cells else DASH for name in sets]
            for row, cells in table.items()
        }
        if metric == "paper_recall":
            rows |= beside(quoted, sets, lambda value: f"{value:.1f}")
        if metric != "p100_1m":
            chance = next(iter(table.values()))
            rows["by chance"] = [percent(chance[name][f"{metric}_by_chance"]) for name in sets]
            rows["queries"] = [str(chance[name][f"{metric}_queries"]) for name in sets]
            rows["radius, m"] = [f"{chance[name][f'{metric}_radius_m']:.2f}" for name in sets]
        yield from markdown_table(["", *sets], rows)


def pair_table(table: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[str]:
    """Mean inliers / matches, and pairs whose motion is right; the paper's features too that have no weights here."""
    sets = list(dict.fromkeys(name for cells in table.values() for name in cells))

    def text_of(cell: Mapping[str, Any] | None) -> str:
        if cell is None or not cell["pairs"]:
            return DASH
        return f"{cell['inliers']:.0f} / {cell['total']:.0f}, {cell['right']} of {cell['pairs']}"

    def quoted(row: str) -> str:
        return " / ".join(f"{value:g}" for value in published.INLIERS[row]) if row in published.INLIERS else DASH

    names = dict.fromkeys((*table, *published.INLIERS))
    rows = {row: [*(text_of(table.get(row, {}).get(name)) for name in sets), quoted(row)] for row in names}
    yield from markdown_table(["", *sets, "the paper's, mean of its sets"], rows)


def drift_table(table: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Iterator[str]:
    """ATE rmse, its share of odometry's, closures and how many are false; the paper's ATE under it."""
    sets = list(dict.fromkeys(name for cells in table.values() for name in cells))

    def text_of(cell: Mapping[str, Any] | None) -> str:
        if cell is None:
            return DASH
        text = f"{cell['ate_rmse_m']:.3f} m"
        if cell.get("closures"):
            text += f" (1/{1 / cell['share_of_odometry']:.1f}); {cell['closures']} closures"
            text += f", {cell['false_closures']} false" if "false_closures" in cell else ""
        return text

    rows: Rows = {row: [text_of(cells.get(name)) for name in sets] for row, cells in table.items()}
    yield from markdown_table(["", *sets], rows | beside(published.ATE_M, sets, lambda value: f"{value:g} m"))
    real = {row: cell for row, cells in table.items() for cell in cells.values() if "ate_mean_m" in cell}
    if real:
        yield "D5 as the paper counts it (mean, row by row, aligned by the first 70 poses; the rows are out of step): "
        yield ", ".join(f"{row} {cell['ate_mean_m']:.3f} m" for row, cell in real.items()) + "."
        yield ""


def number(value: float | int | None) -> str:
    """Four digits, or a dash."""
    return DASH if value is None else f"{value:.4g}"


def write_ablations(out: Path, lines: Sequence[str], found: Mapping[str, Any]) -> None:
    """Writes ablations.md and ablations.json, each whole."""
    with whole_file(out / "ablations.md") as file:
        file.write("\n".join(["# Ablations", "", *lines, ""]))
    with whole_file(out / "ablations.json") as file:
        json.dump(found, file, indent=1, allow_nan=False)


def write(out: Path, sections: Sequence[tuple[str, Sequence[str]]], tables: Mapping[str, Any]) -> None:
    """Writes paper.md and tables.json, each whole."""
    with whole_file(out / "paper.md") as file:
        for title, lines in sections:
            file.write("\n".join([title, "", *lines, ""]))
    with whole_file(out / "tables.json") as file:
        json.dump(tables, file, indent=1, allow_nan=False)
        file.write("\n")
