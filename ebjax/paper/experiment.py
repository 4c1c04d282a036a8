"""The paper's experiments in order: worlds, tables 1 to 4, figures 4 to 6; every step goes through the cells.

A step asks for its run only when a cell is missing, so what is done already costs no image.
"""

import json
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import ebjax
from ebjax.features.extractor import EXTRACTORS, extractor, usable
from ebjax.features.table import INPUTS as SEEN_AS
from ebjax.features.table import Pair, compare_pairs
from ebjax.io.images import read_both
from ebjax.io.pairs import read_pairs
from ebjax.paper import drift, figures, page, worlds
from ebjax.paper.cells import Cells, weighed
from ebjax.paper.drift import Closed, close_loops
from ebjax.paper.pairs import cut_pairs
from ebjax.paper.retrieval import BOTH, FLOOR, INPUTS, TURNED, Retrieval
from ebjax.paper.run import Run, read_run
from ebjax.places.descriptor import DESCRIPTORS, Descriptor, descriptor
from ebjax.places.search import rankings
from ebjax.slam.config import PipelineConfig

Tables = dict[str, dict[str, dict[str, dict[str, Any]]]]
"""table -> row -> data set -> metric."""

TABLE_1 = ("netvlad", "floornet", "rootsift-vlad", "joint")
JOINT_INPUTS = (FLOOR, TURNED, BOTH)
REAL = "real"
PICTURES = {"trajectory": figures.trajectory, "map": figures.registered_maps}
"""Of a run through the pipeline."""


class Experiment:
    """The settings that every cell depends on, and what was found to be missing.

    Attributes:
      out: where everything goes.
      tables: what was measured.
      left_out: rows that could not be measured, and why.
      sources: of every set, the world it was rendered from.
    """

    def __init__(self, out: Path, folder: Path, *, quick: bool, pairs: int, weights: Path | None, seed: int):
        self.out, self.folder, self.quick, self.pair_count = out, folder, quick, pairs
        self.weights, self.seed = weights, seed
        self.cells = Cells(out / "cells")
        self.tables: Tables = {}
        self.left_out: dict[str, str] = {}
        self.pipeline = PipelineConfig(seed=seed, motion="wheels")
        self._configs: dict[str, Any] = {}

    def config(self, name: str) -> Any:
        """The world of a set.

        Raises:
          ValueError: there is no such file, or it is not understood.
        """
        if name not in self._configs:
            self._configs[name] = worlds.read_world(self.folder, name, quick=self.quick)
        return self._configs[name]

    def define(self, name: str, config: Any) -> None:
        """Makes a world known that has no file."""
        self._configs[name] = config

    def path(self, name: str) -> Path:
        """The set's sequence, rendered if need be."""
        return worlds.render(self.config(name), name, self.out / "worlds")

    @lru_cache(maxsize=2)  # noqa: B019 - one experiment a process
    def run(self, name: str) -> Run:
        """The set's run."""
        return read_run(self.path(name))

    @lru_cache(maxsize=1)  # noqa: B019
    def retrieval(self, name: str, which: str) -> Retrieval:
        """A descriptor on a set."""
        return Retrieval(self.run(name), self.descriptor(which))

    @lru_cache(maxsize=1)  # noqa: B019
    def closed(self, name: str) -> Closed:
        """The set through the pipeline."""
        print(f"closing the loops of {name}", flush=True)
        return close_loops(self.run(name), self.pipeline)

    def descriptor(self, which: str) -> Descriptor:
        """By name; raises ValueError where it has no weights."""
        return descriptor(which, self.weights)

    def settings(self, name: str | None = None, **more: Any) -> dict[str, Any]:
        """What a cell depends on."""
        world = {} if name is None else {"world": worlds.settings(self.config(name), name)}
        return {"ebjax": ebjax.__version__, "seed": self.seed, **world, **more}

    def add(self, table: str, row: str, column: str, values: Mapping[str, Any]) -> None:
        """Puts a cell into the tables."""
        self.tables.setdefault(table, {}).setdefault(row, {})[column] = dict(values)

    def recall(self, names: tuple[str, ...]) -> None:
        """Tables 1 and 2, set by set."""
        chosen = []
        for which in DESCRIPTORS:
            try:
                self.descriptor(which)
                chosen.append(which)
            except ValueError as fault:
                self.left_out[which] = page.reason(fault)
        for name in names:
            for which in chosen:
                ways = rankings(self.descriptor(which).has_maps)
                inputs = JOINT_INPUTS if which == "joint" else INPUTS if which in TABLE_1 else (TURNED,)
                for seen_as in inputs:
                    cell = self.cells.values(
                        f"recall {name} {which} {seen_as}",
                        self.settings(
                            name,
                            descriptor=which,
                            input=seen_as,
                            rankings=ways,
                            **weighed(self.descriptor(which).weights),
                        ),
                        partial(self._recall, name, which, seen_as, ways),
                    )
                    for ranking in ways:
                        label = f"{which}, {ranking}" if len(ways) > 1 else which
                        if which in TABLE_1:
                            self.add("table 1", f"{label}: {seen_as}", name, cell[ranking])
                        if seen_as == (BOTH if which == "joint" else TURNED):
                            self.add("table 2", label, name, cell[ranking])

    def correspondences(self, names: tuple[str, ...], real: Path | None) -> None:
        """Table 3: on pairs cut from the sets, and on real ones where a folder of them is given.

        A motion is right as in `ebjax.features.table`: within twice what the truth is known to, or else 3 px.
        """
        files = [] if real is None else read_pairs(real)
        found, absent = usable(list(EXTRACTORS), self.weights)
        self.left_out |= {which: page.reason(why) for which, why in absent.items()}

        @lru_cache(maxsize=1)
        def pairs(name: str) -> list[Pair]:
            if name == REAL:
                return [Pair(f.name, *read_both(f.a, f.b), f.quad, f.b_from_a, f.truth_px) for f in files]
            return cut_pairs(self.run(name), name, self.pair_count)

        def measure(name: str, which: str) -> dict[str, Any]:
            return _pair_means(which, self.weights, pairs(name), self.seed)

        for name in (*names, *((REAL,) if real is not None else ())):
            for which in found:
                settings = self.settings(None if name == REAL else name, extractor=which, pairs=self.pair_count)
                settings |= weighed(found[which].weights)
                settings |= {"truth_px": {f.name: f.truth_px for f in files}} if name == REAL else {}
                cell = self.cells.values(
                    f"pairs {name} {which}",
                    settings,
                    partial(measure, name, which),
                )
                for seen_as in SEEN_AS:
                    self.add("table 3", f"{which}: {seen_as}", name, cell[seen_as])

    def trajectories(self, names: tuple[str, ...], d5: Path | None) -> None:
        """Table 4."""
        for name in names:
            cell = self.cells.values(
                f"drift {name}",
                self.settings(name, pipeline=repr(self.pipeline)),
                partial(self._drift, name),
            )
            for row in drift.ROWS:
                self.add("table 4", row, name, cell[row])
        if d5 is not None:
            cell = self.cells.values(
                "drift D5 real",
                self.settings(pipeline=repr(self.pipeline)),
                lambda: drift.measure_d5(d5, self.pipeline),
            )
            for row, values in cell.items():
                self.add("table 4", row, drift.REAL_D5, values)

    def draw(self, names: tuple[str, ...], plans: tuple[str, ...]) -> list[tuple[str, Path]]:
        """Figures 4 to 6 and the curves: caption and file."""
        drawn = []

        def picture(caption: str, file: str, settings: Mapping[str, Any], make: Callable) -> None:
            drawn.append((caption, self.cells.picture(self.out / file, settings, make)))

        every = {name: self.settings(name) for name in (*names, *plans)}
        sets = {name: every[name] for name in names}
        if names:
            caption = "Figure 4: the same floor on the way out and on the way back; raw, from above, and turned by pi."
            picture(caption, "figure4_floor_views.png", sets, lambda: figures.floor_views(map(self.run, names), names))
        for name in names:
            caption = f"Figure 5: correspondences in {name}, floornet on floor views, the second turned by pi."
            picture(caption, f"figure5_matches_{name}.png", every[name], partial(self._matches, name))
        for name in plans:
            settings = every[name] | {"pipeline": repr(self.pipeline)}
            for what in PICTURES:
                draw = partial(self._drawn, what, name)
                picture(f"Figure 6: {what} of {name}.", f"figure6_{what}_{name}.png", settings, draw)
        if names:
            table = {"table": {row: self.tables["table 1"][row] for row in sorted(self.tables["table 1"])}}
            digest = {"table": json.dumps(table, sort_keys=True)}
            caption = "Precision over recall as answers are accepted by score, right within 1 m."
            picture(caption, "curves.png", digest, lambda: figures.curves(self.tables["table 1"], names))
        return drawn

    def _drawn(self, what: str, name: str) -> bytes:
        return PICTURES[what](self.closed(name))

    def _recall(self, name: str, which: str, seen_as: str, ways: tuple[str, ...]) -> dict[str, Any]:
        return self.retrieval(name, which).measure(seen_as, ways, seed=self.seed)

    def _drift(self, name: str) -> dict[str, Any]:
        return drift.measure(self.closed(name), self.pipeline)

    def _matches(self, name: str) -> bytes:
        pairs = cut_pairs(self.run(name), name, 1)
        if not pairs:
            raise ValueError(f"{self.path(name)}: no two frames face each other over the same floor")
        return figures.matches(pairs[0], extractor("floornet"))


def _pair_means(which: str, weights: Path | None, pairs: list[Pair], seed: int) -> dict[str, dict[str, Any]]:
    """Per input: mean inliers and matches, pairs whose motion is right, pairs, and the median error.

    A pair without a motion is infinitely wrong; None where half of them are.
    """
    row = compare_pairs(extractor(which, weights), pairs, seed=seed)
    result = {}
    for seen_as, cells in row.items():
        every = list(cells.values())
        error_px = float(np.median([cell.error_px for cell in every])) if every else np.inf
        result[seen_as] = {
            "inliers": float(np.mean([cell.inliers for cell in every])) if every else None,
            "total": float(np.mean([cell.total for cell in every])) if every else None,
            "right": sum(cell.right for cell in every),
            "pairs": len(every),
            "median_error_px": error_px if np.isfinite(error_px) else None,
        }
    return result
