"""Figures of the paper's experiments as PNG bytes: images in a grid, precision over recall, measures over a setting."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, UInt8

from ebjax.viz.figures import AFTER, BEFORE, LOOP, TRUTH, new_figure, painted

COLOURS = (BEFORE, LOOP, "#5b5ea6", AFTER, "#7a4988", TRUTH, "#2f6f3e", "#b00020", "#3b3b3b", "#2b9eb3")


def image_grid(rows: Mapping[str, Sequence[UInt8[np.ndarray, "_ _ 3"]]], columns: Sequence[str]) -> bytes:
    """Draws one row of images a name (Early Bird, figure 4).

    Args:
      rows: name -> as many RGB images as there are columns; any sizes.
      columns: what each column shows.
    """
    figure = new_figure(2.4 * len(columns), 1.95 * len(rows) + 0.3)
    grid = figure.subplots(len(rows), len(columns), squeeze=False)
    for axes_row, (name, images) in zip(grid, rows.items(), strict=True):
        for axes, image in zip(axes_row, images, strict=True):
            axes.imshow(image, interpolation="antialiased")
            axes.set(xticks=[], yticks=[])
            for spine in axes.spines.values():
                spine.set_visible(False)
        axes_row[0].set_ylabel(name, fontsize=10)
    for axes, title in zip(grid[0], columns, strict=True):
        axes.set_title(title, fontsize=10)
    return painted(figure)


def precision_over_recall(
    panels: Mapping[str, Mapping[str, tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"]]]],
) -> bytes:
    """Draws a panel a name, in it a curve a label: (recall, precision)."""
    across = min(4, len(panels))
    down = -(-len(panels) // across)
    figure = new_figure(max(2.9 * across, 7.0), 2.7 * down + 0.5)
    grid = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
    labels = list(dict.fromkeys(label for curves in panels.values() for label in curves))
    for axes, (name, curves) in zip(grid, panels.items(), strict=False):
        for label, (recall, precision) in curves.items():
            axes.plot(recall, precision, color=COLOURS[labels.index(label) % len(COLOURS)], lw=1.5, label=label)
        axes.set_title(name, fontsize=10)
        axes.set(xlim=(0, 1.02), ylim=(0, 1.04))
        axes.grid(color="#e6e8ea", lw=0.6)
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    figure.supxlabel("recall", fontsize=10)
    figure.supylabel("precision", fontsize=10)
    handles = {label: line for axes in grid for line in axes.get_lines() if (label := str(line.get_label()))}
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=6, frameon=False, fontsize=9)
    return painted(figure)


def over_setting(
    panels: Mapping[str, Mapping[str, Mapping[str, float | int | None]]], setting: str, *, log: Sequence[str] = ()
) -> bytes:
    """Draws measures over a setting: panel (what is measured) -> series -> value of the setting -> number.

    Args:
      panels: values of the setting are written as text; where all are numbers the axis is one of numbers.
      setting: its name.
      log: panels with a logarithmic axis.
    """
    figure = new_figure(4.4 * len(panels), 3.4)
    labels = list(dict.fromkeys(name for series in panels.values() for name in series))
    for axes, (measure, series) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        values = list(dict.fromkeys(value for points in series.values() for value in points))
        numbers = [_number(value) for value in values]
        at = {v: float(k) if None in numbers else n for k, (v, n) in enumerate(zip(values, numbers, strict=True))}
        for name, points in series.items():
            known = sorted((at[value], number) for value, number in points.items() if number is not None)
            colour = COLOURS[labels.index(name) % len(COLOURS)]
            style = "o" if None in numbers else "o-"
            axes.plot(*np.array(known, float).reshape(-1, 2).T, style, color=colour, lw=1.4, ms=5, label=name)
        if None in numbers:
            axes.set_xticks(range(len(values)), values, rotation=30, ha="right", fontsize=9)
        axes.set(xlabel=setting, ylabel=measure)
        axes.set_yscale("log" if measure in log else "linear")
        if measure not in log:
            axes.set_ylim(0, None)
        axes.grid(color="#e6e8ea", lw=0.6)
        if len(series) > 1 or next(iter(series), ""):
            axes.legend(frameon=False, fontsize=8)
    return painted(figure)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def maps(panels: Mapping[str, tuple[UInt8[np.ndarray, "_ _ 4"], tuple[float, float, float, float]]]) -> bytes:
    """Draws floor maps on one scale, a panel a name: RGBA image and its extent (x_min, x_max, y_min, y_max), m."""
    extents = np.array([extent for _, extent in panels.values()])
    low, high = extents[:, [0, 2]].min(0), extents[:, [1, 3]].max(0)
    ratio = float((high[0] - low[0]) / (high[1] - low[1]))
    beside = ratio < 2
    down, across = (1, len(panels)) if beside else (len(panels), 1)
    width = 4.2 if beside else 9.0
    figure = new_figure(width * across, down * (width / float(np.clip(ratio, 0.4, 12)) + 0.6))
    grid = figure.subplots(down, across, squeeze=False).ravel()
    for axes, (name, (image, extent)) in zip(grid, panels.items(), strict=True):
        axes.set_facecolor("#eceff1")
        axes.imshow(image, extent=extent, interpolation="antialiased")
        axes.set(title=name, xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m")
        axes.set_aspect("equal")
    return painted(figure)
