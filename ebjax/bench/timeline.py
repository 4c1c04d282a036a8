"""What every keyframe of a drive took: time, processor time, memory, programs."""

import dataclasses
import resource
import sys
import time

import numpy as np

from ebjax.bench.programs import Programs
from ebjax.slam.frame import Update
from ebjax.slam.table import Table

WARM = 64
"""Keyframes at the start, in which programs are compiled and caches filled."""
PART = 1000


@dataclasses.dataclass
class Timeline:
    """Keyframe by keyframe.

    Attributes:
      rows: `keyframe` whole numbers; `add_ms` of `Mapper.add`, `wall_ms` since the keyframe before, with all that lies
        between: frames that are no keyframes, waiting for images to be decoded; `cpu_ms` likewise, of all threads;
        `peak_mb` of the process; `programs` asked for by then in `add`.
    """

    programs: Programs
    rows: Table = dataclasses.field(
        default_factory=lambda: Table(
            keyframe=int, add_ms=float, wall_ms=float, cpu_ms=float, peak_mb=float, programs=int
        )
    )
    _since: tuple[float, float] | None = None

    def told(self, update: Update) -> None:
        """After every frame."""
        now = time.perf_counter(), time.process_time()
        if update.keyframe is None:
            return
        wall, cpu = (0.0, 0.0) if self._since is None else (a - b for a, b in zip(now, self._since, strict=True))
        self._since = now
        self.rows.append(
            keyframe=update.keyframe,
            add_ms=update.milliseconds,
            wall_ms=1e3 * wall,
            cpu_ms=1e3 * cpu,
            peak_mb=peak_mb(),
            programs=self.programs.here,
        )

    def lines(self) -> list[str]:
        """In words."""
        rows = self.rows
        if len(rows) <= WARM:
            return [f"{len(rows)} keyframes are too few: the first {WARM} fill caches and compile programs"]
        names = {"add_ms": "Mapper.add, ms", "wall_ms": "from keyframe to keyframe, ms", "cpu_ms": "processor, ms"}
        lines = [
            f"{len(rows):,} keyframes, the first {WARM} left out; peak memory {rows.peak_mb.max():,.0f} MB; "
            f"{int(rows.programs[-1] - rows.programs[WARM])} programs compiled or read within Mapper.add",
            f"{'':32} {'p50':>7} {'p95':>7} {'p99':>7} {'max':>7} {'mean':>7}",
        ]
        for name, label in names.items():
            values = getattr(rows, name)[WARM:]
            lines.append(f"{label:32} {_figures(values)} {values.mean():7.1f}")
        part = min(PART, (len(rows) - WARM) // 2)
        for label, some in (
            (f"the first {part}", rows.wall_ms[WARM:][:part]),
            (f"the last {part}", rows.wall_ms[-part:]),
        ):
            lines.append(f"{'  ' + label:32} {_figures(some)} {some.mean():7.1f}")
        return lines

    def arrays(self) -> dict[str, list]:
        """For a JSON file."""
        names = ("keyframe", "add_ms", "wall_ms", "cpu_ms", "peak_mb", "programs")
        return {name: np.round(getattr(self.rows, name), 2).tolist() for name in names}


def _figures(values: np.ndarray) -> str:
    return " ".join(f"{value:7.1f}" for value in (*np.percentile(values, [50, 95, 99]), values.max()))


def peak_mb() -> float:
    """Most memory that the process has held so far, MB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
