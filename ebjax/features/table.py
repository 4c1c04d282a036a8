"""Extractors x inputs over pairs of known motion: how many matches agree, and on the right one (Early Bird, table 3).

The inputs are the raw images, both seen from above, and from above with the second turned by pi. A motion is right
where it takes the floor that both quads show to where it belongs, on average: within twice what the truth itself is
known to, or within 3 px of a view of 400 px where that is not known.
"""

import dataclasses
import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float, UInt8

from ebjax.features.extractor import Extractor
from ebjax.features.pair import Comparison, PlaneView, checked_quad, compare, extract, look, quad_view, raw_view
from ebjax.features.record import FLOOR, RAW, TURNED, image_b_from_a
from ebjax.geometry.homography import apply, from_four_points
from ebjax.geometry.ransac import Model

RIGHT_PX, SIDE_PX, GRID = 3.0, 400, 33
TRUTH_SIGMAS = 2.0
INPUTS = (RAW, FLOOR, TURNED)


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two images of one floor by one camera, and the homography of the floor between them.

    Attributes:
      name: of the pair.
      image_a: the first.
      image_b: the second.
      quad: the floor in either, (x, y) px: far left, far right, near right, near left.
      b_from_a: px of a to px of b.
      truth_px: rms of the points that it was fitted to, px of a view of SIDE_PX; None: not known.
    """

    name: str
    image_a: UInt8[np.ndarray, "H W 3"]
    image_b: UInt8[np.ndarray, "H W 3"]
    quad: Float[np.ndarray, "4 2"]
    b_from_a: Float[np.ndarray, "3 3"]
    truth_px: float | None = None

    @property
    def right_px(self) -> float:
        """Below this error a motion is right, px of a view of SIDE_PX."""
        return RIGHT_PX if self.truth_px is None else TRUTH_SIGMAS * self.truth_px


@dataclasses.dataclass(frozen=True)
class Cell:
    """One extractor, one input, one pair.

    Attributes:
      inliers: matches that agree on one motion.
      total: matches.
      believed: whether chance would hardly show so many.
      error_px: of that motion, in a view of SIDE_PX; infinite where there is none.
      right_px: below this error the motion is right.
      keypoints: of the second view.
      view_ms: what finding them took, looked at for the second time; NaN where it was not measured.
    """

    inliers: int
    total: int
    believed: bool
    error_px: float
    right_px: float = RIGHT_PX
    keypoints: int = 0
    view_ms: float = math.nan

    @property
    def right(self) -> bool:
        """Whether the motion is the true one."""
        return self.error_px < self.right_px


Row = dict[str, dict[str, Cell]]
"""input -> pair -> cell."""


def compare_inputs(
    chosen: Extractor,
    views: Mapping[str, PlaneView],
    image_a: UInt8[np.ndarray, "H W 3"],
    image_b: UInt8[np.ndarray, "H W 3"],
    *,
    model: Model | Literal["auto"] = "auto",
    tolerance: float = 0.01,
    seed: int = 0,
) -> Iterator[tuple[str, Comparison, Model]]:
    """Yields (input, comparison, model) for the raw images, the floor views, and the floor views with R_pi.

    Args:
      chosen: the local feature.
      views: RAW and, where the floor is known, FLOOR.
      image_a: the first image.
      image_b: the second.
      model: of the motion on the floor; auto: rigid where the view is metric, else a homography, as on raw images.
      tolerance: largest residual of an inlier, as a share of the view's side.
      seed: of RANSAC.
    """
    for place, view in views.items():
        used: Model = "rigid" if view.metric else "homography"
        if model != "auto" and place != RAW:
            used = model
        a = extract(chosen, image_a, view)
        for opposing in (False,) if place == RAW else (False, True):
            b = extract(chosen, image_b, view, turned=opposing)
            yield TURNED if opposing else place, compare(a, b, view, model=used, tolerance=tolerance, seed=seed), used


def motion_error_px(pair: Pair, b_from_a: Float[np.ndarray, "3 3"]) -> float:
    """How far a motion puts the floor that both quads show from where it belongs, the mean in px of a floor view."""
    corners = SIDE_PX * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    image_from_square = np.asarray(from_four_points(corners, pair.quad))
    square_from_image = np.linalg.inv(image_from_square)
    steps = np.linspace(0, SIDE_PX, GRID)
    in_a = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    true, found = (
        np.asarray(apply(square_from_image @ motion @ image_from_square, in_a)) for motion in (pair.b_from_a, b_from_a)
    )
    common = ((true >= 0) & (true <= SIDE_PX)).all(1)
    if not common.any():
        raise ValueError(f"{pair.name}: the quads of the two images have no floor in common")
    error = float(np.linalg.norm(found - true, axis=1)[common].mean())
    return error if math.isfinite(error) else math.inf


def compare_pairs(chosen: Extractor, pairs: Sequence[Pair], *, margin: float | int = 0.5, seed: int = 0) -> Row:
    """One extractor on every pair: a row of the table.

    Raises:
      ValueError: a pair without common floor, or a quad that is none; the pair is named.
    """
    cells: Row = {name: {} for name in INPUTS}
    for pair in pairs:
        height, width = pair.image_a.shape[:2]
        try:
            quad = checked_quad(tuple(pair.quad.ravel().tolist()), width, height)
        except ValueError as error:
            raise ValueError(f"{pair.name}: {error}") from None
        views = {RAW: raw_view(width, height), FLOOR: quad_view(quad, SIDE_PX, margin)}
        for name, found, _ in compare_inputs(chosen, views, pair.image_a, pair.image_b, seed=seed):
            view = views[RAW if name == RAW else FLOOR]
            off_px = motion_error_px(pair, image_b_from_a(found, view)) if found.inliers else math.inf
            cells[name][pair.name] = Cell(found.inliers, found.total, found.believed, off_px, pair.right_px)
        # What the view costs is of interest where the views are compared as they are meant to be.
        count, took_ms = _one_look(chosen, pair.image_b, views[FLOOR])
        cells[TURNED][pair.name] = dataclasses.replace(cells[TURNED][pair.name], keypoints=count, view_ms=took_ms)
    return cells


def _one_look(chosen: Extractor, image: UInt8[np.ndarray, "H W 3"], view: PlaneView) -> tuple[int, float]:
    """Keypoints of a view, and the least of three times that finding them takes, ms; compiling does not count."""
    shown = look(image, view)
    find = jax.jit(chosen.extract) if chosen.jitted else chosen.extract
    found, took = jax.block_until_ready(find(*shown)), []
    for _ in range(3):
        start = time.perf_counter()
        jax.block_until_ready(find(*shown))
        took.append(1000 * (time.perf_counter() - start))
    return int(np.asarray(found.valid).sum()), min(took)


def markdown(rows: Mapping[str, Row], weights_mb: Mapping[str, float] | None = None) -> Iterator[str]:
    """Lines of three tables: the means over the pairs, the turned floor views side by side, and every pair.

    Args:
      rows: of the table.
      weights_mb: size of the weights of those that have some.
    """
    yield "Mean inliers / matches, and pairs whose motion is right."
    yield ""
    yield f"| extractor | {' | '.join(INPUTS)} |"
    yield "|---" * (1 + len(INPUTS)) + "|"
    for extractor, inputs in rows.items():
        yield f"| {extractor} | {' | '.join(_mean(list(inputs[name].values())) for name in INPUTS)} |"
    yield ""
    yield f"{TURNED}: means over the pairs, the median error in px of a {SIDE_PX} px view, and what a view costs."
    yield ""
    yield "| extractor | keypoints | inliers | inlier ratio | error, px | right | ms a view | MB |"
    yield "|---" * 8 + "|"
    for extractor, inputs in rows.items():
        yield f"| {extractor} | {_cost(list(inputs[TURNED].values()), (weights_mb or {}).get(extractor))} |"
    pairs = next((inputs[RAW] for inputs in rows.values()), {})
    yield ""
    yield f"Inliers / matches, and the error of the motion, px of a {SIDE_PX} px view; * more than chance would show."
    yield ""
    heads = [f"{pair} (right below {cell.right_px:.1f} px)" for pair, cell in pairs.items()]
    yield f"| extractor | input | {' | '.join(heads)} |"
    yield "|---" * (2 + len(pairs)) + "|"
    for extractor, inputs in rows.items():
        for name in INPUTS:
            yield f"| {extractor} | {name} | {' | '.join(_one(inputs[name][pair]) for pair in pairs)} |"


def _cost(cells: list[Cell], mb: float | None) -> str:
    keypoints, inliers, view_ms = (
        float(np.mean([getattr(cell, key) for cell in cells])) for key in ("keypoints", "inliers", "view_ms")
    )
    ratio = np.mean([cell.inliers / max(cell.total, 1) for cell in cells])
    error = float(np.median([cell.error_px for cell in cells]))
    parts = [f"{keypoints:.0f}", f"{inliers:.0f}", f"{ratio:.2f}", f"{error:.2f}" if error < SIDE_PX else "-"]
    parts += [f"{sum(cell.right for cell in cells)} of {len(cells)}", f"{view_ms:.0f}" if view_ms == view_ms else "-"]
    return " | ".join([*parts, "-" if mb is None else f"{mb:.1f}"])


def _mean(cells: list[Cell]) -> str:
    inliers, total = (np.mean([getattr(cell, key) for cell in cells]) for key in ("inliers", "total"))
    return f"{inliers:.0f} / {total:.0f}, {sum(cell.right for cell in cells)} of {len(cells)}"


def _one(cell: Cell) -> str:
    error = f"{cell.error_px:.1f} px" if cell.error_px < SIDE_PX else "-"
    return f"{cell.inliers} / {cell.total}{' *' * cell.believed}, {error}"


def as_json(rows: Mapping[str, Row], **settings: Any) -> str:
    """The text of a JSON file: settings, and under "table" extractor -> input -> pair -> numbers, null for none."""

    def plain(cell: Cell) -> dict[str, Any]:
        numbers = dataclasses.asdict(cell)
        none = {key: None for key in ("error_px", "view_ms") if not math.isfinite(numbers[key])}
        return {**numbers, **none, "right": cell.right}

    table = {
        extractor: {name: {pair: plain(cell) for pair, cell in cells.items()} for name, cells in inputs.items()}
        for extractor, inputs in rows.items()
    }
    return json.dumps({**settings, "table": table}, indent=1, allow_nan=False) + "\n"
