"""What the result depends on: length of the way, the floor's pattern, lateral shift, number of closures, kernel.

Each measures one setting and leaves the rest of a base world as it is: a straight corridor of glazed tiles whose
odometry drifts as D5's. Every measure is one of table 1 (default descriptor, floor + pi) or of table 4.
"""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from ebjax.evaluation.run import spread_rows
from ebjax.floors.robot import RobotConfig
from ebjax.floors.surface import LEARNED, FloorConfig
from ebjax.paper.drift import ODOMETRY, OURS, ate_rmse_m, measure
from ebjax.paper.experiment import Experiment
from ebjax.paper.retrieval import TURNED
from ebjax.posegraph.falseloops import add_false_loops
from ebjax.posegraph.lm import solve
from ebjax.viz import experiments
from ebjax.worlds.render import Config as WorldConfig

BASE = "base"
KERNELS = ("none", "huber", "cauchy", "geman-mcclure", "dcs", "tls", "gnc-tls", "gnc-gm", "pcm", "consensus")
FALSE_SEEDS = (0, 1, 2)
OF_RECALL = ("recall_at_1_1m", "recall_at_1_1m_queries", "one_way_recall", "paper_recall", "p100_1m")
OF_DRIFT = ("ate_rmse_m", "share_of_odometry", "closures", "false_closures")

Points = dict[str, dict[str, dict[str, Any]]]
"""series -> value of the setting -> metric."""


@dataclasses.dataclass(frozen=True)
class Scale:
    """How much is measured: that of a quick look, and of a full one."""

    way_m: float = 16.0
    step_m: float = 0.25
    lengths_m: tuple[float, ...] = (5.0, 10.0, 20.0, 40.0)
    designs: tuple[int, ...] = (1, 2, 4, 16)
    shifts_m: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
    closures: tuple[int, ...] = (0, 1, 2, 3, 5, 10, 20)
    false_shares: tuple[float, ...] = (0.0, 0.1, 0.3, 0.5, 0.7)


QUICK = Scale(8.0, 0.4, (4.0, 8.0, 16.0), (1, 16), (0.0, 0.4, 0.8), (0, 1, 2, 5, 10), (0.0, 0.3, 0.5))


def base_world(scale: Scale, seed: int, *, way_m: float | None = None, shift_m: float = 0.25, **floor: Any) -> Any:
    """The base world with something changed."""
    robot = RobotConfig(
        distance_m=scale.way_m if way_m is None else way_m,
        step_m=scale.step_m,
        lateral_offset_m=shift_m,
        wheels="d5",
    )
    return WorldConfig(seed=100 + seed, robot=robot, floor=FloorConfig(**floor))


class Ablations:
    """Measures through the experiment's cells."""

    def __init__(self, experiment: Experiment, scale: Scale):
        self.experiment, self.scale = experiment, scale

    def world(self, name: str, config: WorldConfig) -> dict[str, Any]:
        """Recall and trajectory error on a world."""
        self.experiment.define(name, config)
        pipeline = self.experiment.pipeline

        def run() -> dict[str, Any]:
            recall = self.experiment.retrieval(name, "rootsift-vlad").measure(TURNED, ("correlation",))["correlation"]
            rows = measure(self.experiment.closed(name), pipeline)
            found = {key: recall[key] for key in OF_RECALL} | {"ate_before_m": rows[ODOMETRY]["ate_rmse_m"]}
            return found | {key: rows[OURS][key] for key in OF_DRIFT}

        return self.experiment.cells.values(
            f"ablation {name}", self.experiment.settings(name, pipeline=repr(pipeline)), run
        )

    def length(self) -> Points:
        """Length of one way."""
        seed = self.experiment.seed
        return {
            "": {
                f"{way:g}": self.world(f"length_{way:g}", base_world(self.scale, seed, way_m=way))
                for way in self.scale.lengths_m
            }
        }

    def pattern(self) -> Points:
        """Family of the floor, and how many distinct glazed tiles repeat; without wear, but for the families."""
        seed, scale = self.experiment.seed, self.scale
        worn = {name: self.world(f"family_{name}", base_world(scale, seed, family=name)) for name in LEARNED}
        designs = {
            f"{count} designs": self.world(f"designs_{count}", base_world(scale, seed, designs=count, disorder=0.0))
            for count in scale.designs
        }
        bare = {
            f"{count} designs": self.world(
                f"bare_{count}", base_world(scale, seed, designs=count, disorder=0.0, wear_per_m2=0.0, dirt=0.0)
            )
            for count in scale.designs
        }
        return {"worn": worn | designs, "without wear and dirt": bare}

    def shift(self) -> Points:
        """Lateral shift between the ways."""
        seed = self.experiment.seed
        return {
            "": {
                f"{shift:g}": self.world(f"shift_{shift:g}", base_world(self.scale, seed, shift_m=shift))
                for shift in self.scale.shifts_m
            }
        }

    def closures(self) -> Points:
        """How many closures are kept, spread along the path; the rest are left out."""

        def run() -> dict[str, Any]:
            closed, pipeline = self._base()
            every = np.flatnonzero(closed.result.kept)
            before, points = ate_rmse_m(closed.run.truth, closed.odometry), {}
            for count in sorted({*(c for c in self.scale.closures if c < len(every)), len(every)}):
                chosen = np.zeros(len(closed.result.kept), bool)
                chosen[spread_rows(every, count)] = True
                error = ate_rmse_m(closed.run.truth, closed.path(chosen, pipeline))
                points[str(count)] = {"ate_rmse_m": error, "share_of_odometry": error / before}
            return {"": points}

        return self._cell("closures", run)

    def kernel(self) -> Points:
        """Kernels against the share of false closures among all: random ones, median of three draws."""

        def run() -> dict[str, Any]:
            closed, _ = self._base()
            true = closed.result.path.graph(closed.result.candidates, closed.result.kept)
            found: dict[str, Any] = {kernel: {} for kernel in KERNELS}
            for share in self.scale.false_shares:
                graphs = [add_false_loops(true, share, seed=seed) for seed in FALSE_SEEDS[: 1 if share == 0 else None]]
                graphs = [dataclasses.replace(g, robust=np.abs(np.asarray(g.i) - np.asarray(g.j)) != 1) for g in graphs]
                for kernel in KERNELS:
                    solved = [np.asarray(solve(graph, kernel=kernel, max_steps=100).poses) for graph in graphs]
                    errors = [ate_rmse_m(closed.run.truth, path) for path in solved]
                    found[kernel][f"{share:g}"] = {"ate_rmse_m": median(errors)}
            return found

        return self._cell("kernel", run)

    def _base(self):
        self.experiment.define(BASE, base_world(self.scale, self.experiment.seed))
        return self.experiment.closed(BASE), self.experiment.pipeline

    def _cell(self, name: str, run: Callable[[], dict[str, Any]]) -> Points:
        self.experiment.define(BASE, base_world(self.scale, self.experiment.seed))
        settings = self.experiment.settings(BASE, pipeline=repr(self.experiment.pipeline), scale=repr(self.scale))
        return self.experiment.cells.values(f"ablation {name}", settings, run)


RECALL, SHARE, ERROR = "R@1 m", "ATE after / odometry", "ATE rmse after, m"
KEYS = {RECALL: "recall_at_1_1m", SHARE: "share_of_odometry", ERROR: "ate_rmse_m"}
FIGURES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "length": ("length of one way, m", (RECALL, SHARE, ERROR)),
    "pattern": ("floor", (RECALL, SHARE)),
    "shift": ("lateral shift between the ways, m", (RECALL, SHARE)),
    "closures": ("closures", (ERROR,)),
    "kernel": ("share of false closures", (ERROR,)),
}
"""Ablation -> what is varied, and what is drawn."""
LOGARITHMIC = (SHARE, ERROR)


def measure_all(ablations: Ablations, out: Path) -> tuple[dict[str, Points], list[tuple[str, Path]]]:
    """All of them with their figures: ablation -> points, and (caption, file)."""
    found: dict[str, Points] = {}
    drawn = []
    for name, (setting, measures) in FIGURES.items():
        found[name] = getattr(ablations, name)()
        panels = {
            measure: {
                series: {value: point.get(KEYS[measure]) for value, point in points.items()}
                for series, points in found[name].items()
            }
            for measure in measures
        }
        draw = partial(experiments.over_setting, panels, setting, log=LOGARITHMIC)
        path = ablations.experiment.cells.picture(out / f"ablation_{name}.png", {"panels": panels}, draw)
        drawn.append((f"Ablation: {setting}.", path))
    return found, drawn
