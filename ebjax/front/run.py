"""A run that was thought over, with what it was driven from: what it says in words, as a picture and as files."""

import dataclasses
import resource
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ebjax.command import dump_config
from ebjax.front.options import made_by
from ebjax.io.atomic import whole_folder
from ebjax.io.sequence import Sequence
from ebjax.mapping.export import export_run
from ebjax.slam.recording import Load
from ebjax.slam.run import Run as Thought
from ebjax.viz.rtabmap_copy import write_rtabmap_copy
from ebjax.viz.run_folder import trajectory_figure, write_run
from ebjax.viz.run_metrics import run_metrics, summary_lines
from ebjax.viz.run_report import write_report

FILES = ("report.html", "trajectory.tum", "loop_closures.csv", "pose_graph.g2o", "metrics.json", "floor_map.png")


class Picture(NamedTuple):
    """A PNG; a notebook shows it."""

    png: bytes

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"Picture({len(self.png) / 1000:.0f} kB; show it in a notebook, or save it: .save(FILE.png))"

    def save(self, path: str | Path) -> None:
        """Writes it.

        Raises:
          OSError: the file cannot be written.
        """
        Path(path).write_bytes(self.png)


class Saved(NamedTuple):
    """A folder, the names of the files that were written into it, and what a user should know, a line each."""

    folder: Path
    files: tuple[str, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"{self.folder}: {', '.join(self.files)}"


@dataclasses.dataclass(frozen=True)
class Driven:
    """What a run was driven from.

    Attributes:
      sequence: its frames.
      load: frame number -> (RGB, depth in m or None); None where it cannot be read, or not any more.
      broken: what is wrong with the frames that could not be read, by name.
      options: as it was asked for; `Run.save` writes them as config.yaml.
      notes: how it was read, a line each.
      took_s: in all, s.
    """

    sequence: Sequence
    load: Load
    broken: Mapping[str, str]
    options: Any
    notes: tuple[str, ...]
    took_s: float


@dataclasses.dataclass(frozen=True, repr=False)
class Run(Thought):
    """A run, thought over. See `ebjax.slam.run.Run` for all that it holds.

    `poses` are x, y (m) and heading (rad) of every frame, at `timestamps` (s). `closures` has i and j (frames),
    opposing, i_from_j and covariance of the loop closures; `candidates` and `reasons` all that were measured, and why
    each counts or not. `graph` and `solution` are the pose graph and its optimum.

    Closures count in frames; `seen(k)` and `floor(k)`, the floor views, in keyframes: frame `keyframes[k]`. The view of
    a closure's later frame i is `seen(int(np.searchsorted(keyframes, i)))`.

    Attributes:
      driven: what it was driven from.
    """

    driven: Driven = dataclasses.field(kw_only=True)

    @classmethod
    def of(cls, thought: Thought, driven: Driven) -> "Run":
        """The run with what it was driven from."""
        return cls(**{f.name: getattr(thought, f.name) for f in dataclasses.fields(Thought)}, driven=driven)

    @cached_property
    def sequence(self) -> Sequence:
        """Its frames, with what the run found to be added to the images' stamps."""
        offset_s = 0.0 if self.motion is None else self.motion.offset.offset_s
        return self.driven.sequence.at_offset(offset_s) if offset_s else self.driven.sequence

    @property
    def timestamps(self) -> Float[np.ndarray, " F"]:
        """Of the frames, s."""
        return self.sequence.timestamps

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """What metrics.json holds: counts, seconds and, where the truth is known, errors."""
        metrics = run_metrics(self.sequence, self.driven.broken, self)
        metrics["seconds"] = {name: round(value, 3) for name, value in self.seconds.items()}
        metrics["ms_per_frame"] = round(1e3 * sum(self.seconds.values()) / len(self.sequence), 2)
        metrics["seconds"]["total"] = round(self.driven.took_s, 3)
        metrics["peak_memory_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)
        return metrics

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful about the camera, the wheels or the clocks, a line each."""
        return tuple((self.metrics["motion"] or {}).get("warnings", ()))

    def summary(self) -> str:
        """What was found and how good it is, a line each; without any closure, why."""
        return "\n".join((*summary_lines(self.metrics), *(f"warning: {line}" for line in self.warnings)))

    def plot(self) -> Picture:
        """The path before and after, the closures and, where it is known, the truth."""
        return Picture(trajectory_figure(self.sequence, self, np.stack([self.closures.i, self.closures.j], 1)))

    def save(self, folder: str | Path) -> Saved:
        """Writes what `python -m ebjax.slam` leaves behind, whole or not at all; other files there are left alone.

        Raises:
          OSError: the folder cannot be written.
        """
        out, sequence, options = Path(folder), self.sequence, self.driven.options
        with whole_folder(out) as partial:
            floor, cells = write_run(partial, sequence, self, self.metrics, options.map_metres_per_px)
            exported = export_run(partial, out, sequence, self, floor, cells)
            copied = write_rtabmap_copy(partial, out, sequence, self)
            dump_config(options, partial / "config.yaml")
            made = made_by(options, sequence.path)
            write_report(partial, sequence, self.driven.load, self, self.metrics, made)
        steps = () if self.motion is None else ("steps.csv",)
        names = (*FILES[:2], *steps, *FILES[2:], *exported.files)
        return Saved(out, names, (*exported.notes, *copied))
