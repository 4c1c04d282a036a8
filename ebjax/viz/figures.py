"""Figures as PNG bytes: the path before, after and in truth; loop candidates; matches; the floor map.

Matplotlib through its objects and its own Agg canvas: no global state, no window system. Positions are metres.
"""

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from ebjax.posegraph.graph import PoseGraph

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which people tell apart who do not see red and green as different; lines differ in style too.
BEFORE, AFTER, TRUTH, LOOP, WRONG = "#d55e00", "#0072b2", "#9aa0a6", "#cc79a7", "#000000"
DASHED = (0, (4, 2))
THIN = 4.0


def trajectory(
    before: Float[np.ndarray, "N 2"],
    after: Float[np.ndarray, "N 2"],
    truth: Float[np.ndarray, "N 2"] | None = None,
    closures: Int[np.ndarray, "K 2"] | None = None,
    *,
    before_name: str = "odometry",
    after_name: str = "after loop closing",
) -> bytes:
    """Draws the path before and after; a thin one, corrected, with its width stretched; the error frame by frame.

    Args:
      before: x, y of every frame, m, aligned with the truth if there is one.
      after: likewise.
      truth: likewise, NaN where unknown.
      closures: frame indices of the kept loops.
      before_name: for the legend.
      after_name: for the legend.
    """
    paths = {before_name: before, after_name: after} | ({} if truth is None else {"truth": truth})
    turn = _along_x(after if truth is None or not np.isfinite(truth).all() else truth)
    paths = {name: path @ turn.T for name, path in paths.items()}
    loops = np.zeros((0, 2), int) if closures is None else closures
    span = np.ptp(np.concatenate([before, after]) @ turn.T, axis=0) + 1e-9
    corrected = np.ptp(paths[after_name], axis=0) + 1e-9
    thin = bool(corrected[0] / corrected[1] > THIN)

    heights = [9.0 / np.clip(span[0] / span[1], 1.2, 8.0) + 0.8] + [2.4] * thin + [2.0] * (truth is not None)
    figure = new_figure(9.0, sum(heights))
    axes = list(figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0])
    _draw_paths(axes[0], paths, loops, before_name, after_name)
    axes[0].set(xlabel="along, m", ylabel="across, m")
    axes[0].set_aspect("equal", "datalim")
    if thin:
        without = {name: path for name, path in paths.items() if name != before_name}
        _draw_paths(axes[1], without, loops, before_name, after_name)
        axes[1].set(xlabel="along, m", ylabel="across (stretched), m")
    legend_above(axes[0])
    if truth is not None:
        for name, colour, style in ((before_name, BEFORE, DASHED), (after_name, AFTER, "-")):
            error = np.linalg.norm(paths[name] - paths["truth"], axis=1)
            label = f"{name}: rmse {np.sqrt(np.nanmean(error**2)):.3f} m"
            axes[-1].plot(error, color=colour, lw=1.4, ls=style, label=label)
        axes[-1].set(xlabel="frame", ylabel="error, m", xlim=(0, max(1, len(before) - 1)), ylim=(0, None))
        legend_above(axes[-1])
    return painted(figure)


def candidates(
    pairs: Int[np.ndarray, "K 2"],
    scores: Float[np.ndarray, " K"],
    kept: Bool[np.ndarray, " K"],
    frames: int,
    similarity: Float[np.ndarray, "N N"] | None = None,
) -> bytes:
    """Draws which frames were taken for the same place: an out-and-back run is a line across the diagonal.

    Args:
      pairs: (earlier frame, later frame) of every candidate.
      scores: larger is more alike.
      kept: candidates that became loop closures.
      frames: number of frames of the run.
      similarity: score of every (later, earlier) pair, NaN where not compared; drawn underneath.
    """
    figure = new_figure(6.0, 5.0)
    axes = figure.subplots()
    colours: dict[str, Any] = {
        "cmap": "viridis",
        "vmin": _finite(np.min, scores, similarity),
        "vmax": _finite(np.max, scores, similarity),
    }
    if similarity is not None:
        edge = len(similarity) - 0.5
        axes.imshow(similarity, origin="lower", extent=(-0.5, edge, -0.5, edge), interpolation="nearest", **colours)
    shown = axes.scatter(pairs[:, 0], pairs[:, 1], c=scores, s=10, linewidths=0, **colours)
    axes.scatter(
        pairs[kept, 0], pairs[kept, 1], s=42, facecolors="none", edgecolors=WRONG, linewidths=1.2, label="loop closures"
    )
    axes.plot([0, frames], [0, frames], color=TRUTH, lw=0.8)
    axes.set(xlabel="earlier frame", ylabel="later frame", xlim=(0, frames), ylim=(0, frames))
    axes.set_aspect("equal")
    figure.colorbar(shown, ax=axes, label="score", shrink=0.8)
    if kept.any():
        legend_above(axes)
    return painted(figure)


def matches(
    image_a: UInt8[np.ndarray, "Ha Wa 3"],
    image_b: UInt8[np.ndarray, "Hb Wb 3"],
    points_a: Float[np.ndarray, "M 2"],
    points_b: Float[np.ndarray, "M 2"],
    inliers: Bool[np.ndarray, " M"],
    *,
    turn_second: bool = False,
    title: str = "",
    max_lines: int = 120,
) -> bytes:
    """Draws two images side by side, the inliers joined by lines (Early Bird, figure 5).

    Args:
      image_a: RGB.
      image_b: RGB; another size is fine.
      points_a: (x, y) in image_a, px.
      points_b: (x, y) in image_b, px, as they are in the unturned image.
      inliers: the matches that agree with the estimated transform.
      turn_second: show image_b turned by pi, as R_pi sees it.
      title: above the images.
      max_lines: an even choice of the inliers where there are more.
    """
    from matplotlib.collections import LineCollection

    if turn_second:
        size = np.array(image_b.shape[1::-1], points_b.dtype)
        image_b, points_b = image_b[::-1, ::-1], size - 1 - points_b
    gap = 8
    canvas = np.full((max(len(image_a), len(image_b)), image_a.shape[1] + gap + image_b.shape[1], 3), 255, np.uint8)
    canvas[: len(image_a), : image_a.shape[1]] = image_a
    canvas[: len(image_b), image_a.shape[1] + gap :] = image_b
    shift = np.array([image_a.shape[1] + gap, 0.0])

    figure = new_figure(9.0, 9.0 * canvas.shape[0] / canvas.shape[1] + (0.35 if title else 0.0))
    axes = figure.subplots()
    axes.imshow(canvas, interpolation="antialiased")
    chosen = np.flatnonzero(inliers)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(len(chosen), max_lines)).astype(int)] if len(chosen) else chosen
    outliers = np.flatnonzero(~inliers)[:max_lines]
    for points in (points_a, points_b + shift):
        axes.plot(*points[outliers].T, "x", color=WRONG, ms=3, mew=0.6, alpha=0.7)
    ends, colours = np.stack([points_a, points_b + shift], 1)[chosen], _rainbow(chosen, len(inliers))
    axes.add_collection(LineCollection(list(ends), colors=colours, linewidths=0.7), autolim=False)
    axes.scatter(ends[..., 0], ends[..., 1], s=4, c=np.repeat(colours, 2, 0), linewidths=0, zorder=3)
    axes.set(xlim=(-0.5, canvas.shape[1] - 0.5), ylim=(canvas.shape[0] - 0.5, -0.5))
    axes.set_axis_off()
    if title:
        axes.set_title(title, fontsize=10, parse_math=False)
    return painted(figure)


def floor_map(
    image: UInt8[np.ndarray, "H W 4"],
    extent: tuple[float, float, float, float],
    path: Float[np.ndarray, "N 2"] | None = None,
    closures: Int[np.ndarray, "K 2"] | None = None,
) -> bytes:
    """Draws the floor mosaic in metres, x to the right, with the path that made it.

    Args:
      image: RGBA, transparent where no floor was seen; rows run along falling y.
      extent: x_min, x_max, y_min, y_max of the image's outer edges, m.
      path: x, y of the frames, m.
      closures: frame indices of the kept loops.
    """
    ratio = (extent[1] - extent[0]) / (extent[3] - extent[2])
    figure = new_figure(9.0, 9.0 / np.clip(ratio, 0.8, 8.0) + 0.6)
    axes = figure.subplots()
    axes.set_facecolor("#eceff1")
    axes.imshow(image, extent=extent, interpolation="antialiased")
    if path is not None:
        axes.plot(*path.T, color=AFTER, lw=1.2, label="path")
        if closures is not None and len(closures):
            axes.plot(*_joined(path[closures]), color=LOOP, lw=0.8, marker="o", ms=2.5, label="loop closures")
        legend_above(axes)
    axes.set(xlabel="x, m", ylabel="y, m", xlim=extent[:2], ylim=extent[2:])
    axes.set_aspect("equal")
    return painted(figure)


def _draw_paths(
    axes: "Axes",
    paths: dict[str, Float[np.ndarray, "N 2"]],
    closures: Int[np.ndarray, "K 2"],
    before_name: str,
    after_name: str,
) -> None:
    if "truth" in paths:
        axes.plot(*paths["truth"].T, color=TRUTH, lw=4.0, alpha=0.6, label="truth", solid_capstyle="round")
    if before_name in paths:
        axes.plot(*paths[before_name].T, color=BEFORE, lw=1.2, ls=DASHED, label=before_name)
    axes.plot(*paths[after_name].T, color=AFTER, lw=1.4, label=after_name)
    if len(closures):
        ends = _joined(paths[after_name][closures])
        axes.plot(*ends, color=LOOP, lw=0.9, marker="o", ms=2.5, label=f"{len(closures)} loop closures")
    axes.grid(color="#e6e8ea", lw=0.6)


def _joined(ends: Float[np.ndarray, "K 2 2"]) -> Float[np.ndarray, "2 n"]:
    """Pieces of line as one that is interrupted: one artist is drawn much faster than K."""
    return np.concatenate([ends, np.full((len(ends), 1, 2), np.nan)], 1).reshape(-1, 2).T


def _along_x(path: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "2 2"]:
    """The rotation that lays a long path along x and leaves its first half heading to the right."""
    centred = path - path.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred)
    if values[1] < THIN * values[0]:
        return np.eye(2)
    along = vectors[:, 1]
    farthest = centred[np.argmax(np.linalg.norm(path - path[0], axis=1))] - centred[0]
    along = along * (np.sign(along @ farthest) or 1.0)
    return np.array([along, [-along[1], along[0]]])


def _finite(pick, *arrays: Float[np.ndarray, "..."] | None) -> float | None:
    values = np.concatenate([array[np.isfinite(array)] for array in arrays if array is not None])
    return float(pick(values)) if len(values) else None


def _rainbow(rows: Int[np.ndarray, " n"], count: int) -> Float[np.ndarray, "n 4"]:
    from matplotlib import colormaps

    return colormaps["turbo"](0.1 + 0.8 * (rows * 0.618 % 1.0 if count > 1 else np.full(len(rows), 0.5)))


def legend_above(axes: "Axes") -> None:
    """Says what the lines are, off the data."""
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize=9)


def new_figure(width_in: float, height_in: float) -> "Figure":
    """An empty one, without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, float(height_in)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def painted(figure: "Figure") -> bytes:
    """As a PNG."""
    if (layout := figure.get_layout_engine()) is not None:
        # With a layout, savefig draws everything twice.
        layout.execute(figure)
        figure.set_layout_engine(None)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def pose_graph(graph: PoseGraph, optimised: Float[np.ndarray, "N P"]) -> bytes:
    """Draws a pose graph from above, before and after: the path through its rows, and the edges that are not steps."""
    figure = new_figure(11.0, 5.2)
    i, j = np.asarray(graph.i), np.asarray(graph.j)
    loops = np.flatnonzero(np.abs(i - j) != 1)
    for axes, poses, name in zip(figure.subplots(1, 2), (graph.poses, optimised), ("before", "after"), strict=True):
        xy = np.asarray(poses)[:, :2] if graph.group == "se2" else np.asarray(poses)[:, 4:6]
        ends = _joined(np.stack([xy[i[loops]], xy[j[loops]]], 1))
        axes.plot(*ends, color=LOOP, lw=0.6, label=f"{len(loops)} loops")
        axes.plot(*xy.T, color=BEFORE if name == "before" else AFTER, lw=0.9, label=f"{len(xy)} poses")
        axes.set(xlabel=f"x {name}, m", ylabel="y, m")
        axes.set_aspect("equal", "datalim")
        legend_above(axes)
    return painted(figure)


def through_turn(
    image: UInt8[np.ndarray, "H W 3"],
    read: dict[str, tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, "K 2"]]],
    *,
    title: str = "",
) -> bytes:
    """Draws keypoints and the same keypoints read through R_pi, and how far apart they are.

    Args:
      image: RGB.
      read: by name, keypoints (x, y) in the image and where the turned image puts them, px.
      title: above the image.
    """
    figure = new_figure(11.0, 5.4)
    shown, axes = figure.subplots(1, 2)
    shown.imshow(image)
    for (name, (here, there)), colour in zip(read.items(), (AFTER, BEFORE), strict=False):
        shown.plot(*_joined(np.stack([here, there], 1)), color=colour, lw=1.2)
        shown.plot(*here.T, ".", color=colour, ms=3)
        label = f"{name}: at most {np.abs(there - here).max(initial=0):.2g} px an axis"
        axes.plot(*(there - here).T, "o", color=colour, ms=5, alpha=0.5, label=label)
    shown.set(xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5))
    shown.set_title(title, fontsize=10, parse_math=False)
    axes.axhline(0, color=TRUTH, lw=0.6, zorder=0)
    axes.axvline(0, color=TRUTH, lw=0.6, zorder=0)
    axes.set(xlabel="x read through the turn, minus x, px", ylabel="y, px", xlim=(-6, 6), ylim=(-6, 6))
    axes.set_aspect("equal")
    legend_above(axes)
    return painted(figure)
