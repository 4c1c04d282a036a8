"""Tables 1 and 2: for every frame of the way back, the frame of the way out that shows the same floor.

Truth is the floor, not the robot: the centres of the two floor views lie within a radius, and the robots face each
other (`ebjax.places.recall.facing_pairs`). `paper_recall` takes a fifteenth of the path, out and back, as radius, as
`ebjax.slam` does. So wide a radius also asks about floor that the way out never saw, at its start; `one_way_recall`
takes a fifteenth of one way, the other reading of the paper's "traverse".
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ebjax.evaluation.retrieval import precision_recall
from ebjax.paper.looks import Kind, keep
from ebjax.paper.run import Run
from ebjax.places.descriptor import Descriptor
from ebjax.places.recall import facing_pairs, precision_100
from ebjax.places.search import search

PAPER_RADIUS = 1 / 15
RAW, FLIP, FLOOR, TURNED, BOTH = "raw", "raw + flip", "floor", "floor + pi", "floor and whole, both ways"
INPUTS = (RAW, FLIP, FLOOR, TURNED)
KINDS: Mapping[str, tuple[Kind, Kind]] = {
    RAW: ("whole", "whole"),
    FLIP: ("whole", "flipped"),
    FLOOR: ("floor", "floor"),
    TURNED: ("floor", "floor"),
    BOTH: ("floor", "floor"),
}
"""How references and queries are looked at."""
WAYS = {RAW: (True, False), FLIP: (True, False), FLOOR: (True, False), TURNED: (False, True), BOTH: (True, True)}
"""Whether references count as they are, and turned by pi."""
CURVE_POINTS = 60


class Retrieval:
    """A descriptor on a run; what it keeps of the frames is computed when first asked for."""

    def __init__(self, run: Run, chosen: Descriptor):
        self.run, self.chosen = run, chosen
        self._kept: dict[tuple[str, Kind], dict[str, np.ndarray]] = {}

    def _frames(self, way: str, kind: Kind) -> dict[str, np.ndarray]:
        if (way, kind) not in self._kept:
            frames = self.run.out if way == "out" else self.run.back
            self._kept[way, kind] = keep(self.run, self.chosen, frames, kind)
        return self._kept[way, kind]

    def measure(self, seen_as: str, rankings: tuple[str, ...], *, seed: int = 0) -> dict[str, dict[str, Any]]:
        """Figures of merit of an input, ranking by ranking.

        Args:
          seen_as: one of KINDS.
          rankings: of `ebjax.places.search`.
          seed: of the vocabulary.

        Returns:
          ranking -> `merits`.
        """
        references, queries = KINDS[seen_as]
        out, back = self._frames("out", references), self._frames("back", queries)
        places = self.chosen.unite({name: np.concatenate([out[name], back[name]]) for name in out}, seed=seed)
        count, asked = len(self.run.out), len(self.run.back)
        allowed = np.zeros((asked, count + asked, 2), bool)
        allowed[:, :count] = np.array(WAYS[seen_as])[None, None, :]
        rows = np.arange(count, count + asked)
        found = {}
        for ranking in rankings:
            best = search(places, jnp.asarray(allowed), ranking=ranking, queries=rows)
            first = np.where(np.asarray(best.valid)[:, 0], np.asarray(best.j)[:, 0], -1)
            found[ranking] = merits(self.run, first, 1 - np.asarray(best.distance, np.float64)[:, 0])
        return found


def merits(run: Run, first: np.ndarray, score: np.ndarray, opposing: np.ndarray | None = None) -> dict[str, Any]:
    """What the first candidates are worth.

    Args:
      run: the run.
      first: for every frame of the way back, a row of the way out, or -1.
      score: of that candidate.
      opposing: whether it is claimed as seen from the opposite side, without which it is wrong; None: not asked.

    Returns:
      recalls in 0..1 with their queries, radius and what a blind guess would get; P100 and the curve at 1 m.
    """
    centre, count = run.view.centre_m, len(run.out)
    result: dict[str, Any] = {}
    paper_m = run.travelled_m * PAPER_RADIUS
    radii = {"paper_recall": paper_m, "one_way_recall": paper_m / 2, "recall_at_1_1m": 1.0, "recall_at_1_0.3m": 0.3}
    for name, radius in radii.items():
        pairs = facing_pairs(run.truth[run.frames], centre, radius)[count:, :count]
        answerable = pairs.any(1)
        right = pairs[np.arange(len(first)), np.maximum(first, 0)] & (first >= 0)
        right = right if opposing is None else right & opposing
        number = int(answerable.sum())
        result[name] = float(right[answerable].mean()) if number else None
        result[f"{name}_queries"] = number
        result[f"{name}_by_chance"] = float(pairs[answerable].mean()) if number else None
        result[f"{name}_radius_m"] = round(radius, 3)
        if name == "recall_at_1_1m":
            result["p100_1m"] = precision_100(np.where(first >= 0, score, -np.inf), right)
            precision, recall = precision_recall(score[first >= 0], right[first >= 0], number)
            chosen = np.unique(np.linspace(0, len(recall) - 1, CURVE_POINTS).round().astype(int))
            result["curve"] = {"recall": recall[chosen].tolist(), "precision": precision[chosen].tolist()}
    return result
