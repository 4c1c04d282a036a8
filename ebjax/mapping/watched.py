"""A run that is watched as it is driven: how far it is on stderr, and its map as it comes in rerun."""

import contextlib
import sys
from collections.abc import Callable

import numpy as np

from ebjax.slam.engine import Engine
from ebjax.slam.frame import Closure, Update
from ebjax.slam.run import Run
from ebjax.viz.live import Live
from ebjax.viz.ticker import LiveLine, PlainLines, ticker


class Watched:
    """Says how far every drive of a run is, and shows the first one, as `slam.pipeline.run` calls it.

    with Watched(len(recording), live) as watched:
        watched.concluded(run(recording, camera, view, config, watch=watched))
    """

    def __init__(self, total: int, live: Live | None = None):
        """Args: the frames of the run; what shows it."""
        self._total, self._live = total, live
        self._engine: Engine | None = None
        self._ticking = contextlib.ExitStack()

    def __call__(self, engine: Engine) -> Callable[[Update], None]:
        """What is called with every update of a drive."""
        self._ticking.close()
        ticking: PlainLines | LiveLine = ticker(self._total)
        self._ticking.enter_context(ticking)
        live = self._live if self._engine is None else None
        self._engine = self._engine or engine
        floor_from_view = np.asarray(engine.view.floor_from_view, np.float64)

        def told(update: Update) -> None:
            if live is not None:
                live.show(update, floor_from_view)
            closures = int((engine.belief.kept & (engine.candidates.i >= engine.start)).sum())
            ticking.update(update.frame, len(engine.numbers), closures, update.milliseconds)
            if update.frame + 1 == self._total:
                self._ticking.close()
                if isinstance(ticking, PlainLines):
                    print(f"frame {self._total:,} was the last: thinking the run over", file=sys.stderr, flush=True)

        return told

    def concluded(self, result: Run) -> None:
        """Shows the run as it was thought over, where its keyframes are those that were shown."""
        engine = self._engine
        if self._live is None or engine is None or not np.array_equal(engine.keyframes.frame, result.keyframes):
            return
        found, last = result.candidates, len(result.poses) - 1
        ends = np.searchsorted(result.keyframes, np.stack([found.i, found.j], 1)).tolist()
        closures = tuple(
            Closure(
                int(found.i[k]), int(found.j[k]), bool(found.opposing[k]), found.i_from_j[k], bool(result.kept[k]),
                result.reasons[k], (i, j),
            )
            for k, (i, j) in enumerate(ends)
        )  # fmt: skip
        update = Update(
            last, float(engine.frames.stamp_s[last]), None, result.poses[last], True, None, np.zeros((3, 3)), closures,
            result.poses[result.keyframes],
        )  # fmt: skip
        self._live.show(update, np.asarray(engine.view.floor_from_view, np.float64))

    def __enter__(self) -> "Watched":
        return self

    def __exit__(self, *stop: object) -> None:
        self._ticking.close()
