"""The loop of every training: steps, a log of JSON lines, checkpoints, validation, early stopping, going on again.

What a step does depends on the state and its number alone, so a run that is killed at any moment and resumed ends with
the numbers it would have had. Checkpoints are Orbax's, renamed into place whole; the two latest stay.
"""

import contextlib
import dataclasses
import errno
import importlib.util
import json
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ebjax.command import progress
from ebjax.io.atomic import whole_file, whole_folder
from ebjax.train import processes
from ebjax.train.log import Log

CHECKPOINTS, PLACE = "checkpoints", "place.json"
SCORE = "score"

State = Any
Metrics = dict[str, float]


@dataclasses.dataclass(frozen=True)
class LoopConfig:
    """How long to train and how often to look."""

    steps: int = 1000
    """Optimisation steps."""
    validate_every: int = 100
    """Steps between validations; each is followed by a checkpoint."""
    patience: int = 10
    """Validations without a better score after which training stops."""
    tensorboard: bool = False
    """Write TensorBoard's event files too: needs pip install "ebjax[train]"."""


@dataclasses.dataclass(frozen=True)
class Task:
    """What is trained.

    Attributes:
      state: a pytree of arrays before the first step.
      step: (state, number) -> (state, metrics); must not depend on anything else that changes.
      validate: state -> metrics; the larger "score" the better.
      export: (state, metrics, folder) writes what training is for.
      settings: plain values on which the numbers depend: a checkpoint of others is not resumed.
    """

    state: State
    step: Callable[[State, int], tuple[State, dict[str, Any]]]
    validate: Callable[[State], dict[str, Any]]
    export: Callable[[State, Metrics, Path], None]
    settings: dict[str, Any]


@dataclasses.dataclass
class _Place:
    """Where a training stands: steps done, the best score, validations since then, seconds spent."""

    step: int = 0
    best: float | None = None
    stale: int = 0
    seconds: float = 0.0


def fit(task: Task, config: LoopConfig, out: Path, *, resume: bool) -> Metrics:
    """Trains, and returns the last validation's metrics.

    Args:
      task: what.
      config: how long.
      out: folder of the log, the checkpoints and the best weights.
      resume: go on from the latest checkpoint in `out`, if there is one.

    Raises:
      ValueError: `out` holds another training; the checkpoint cannot be read or is of other settings; a loss that is
        not finite.
      OSError: nothing can be written there.
    """
    check(config)
    store = Checkpoints(out / CHECKPOINTS, {**task.settings, **_numbers(config)})
    if not resume and store.steps():
        raise ValueError(f"{out}: holds a training; give --resume to go on with it, or another --out")
    state, place = store.load(task.state) if resume else (task.state, _Place())
    processes.agree((place.step, store.settings), f"config or step in {store.folder}")
    state = processes.replicate(state)
    log = Log(out, place.step, events=config.tensorboard)
    started = time.perf_counter() - place.seconds
    left = range(place.step, config.steps if place.stale < config.patience else place.step)
    metrics = _floats(task.validate(state)) if place.step == 0 or not left else {}
    if place.step == 0:
        log.write(0, "validation", metrics, 0.0)
    for number in progress(left, len(left), "training") if processes.first() else left:
        state, found = task.step(state, number)
        place.step, place.seconds = number + 1, time.perf_counter() - started
        values = _floats(found)
        if not np.isfinite(values["loss"]):
            raise ValueError(f"step {place.step}: the loss is {values['loss']}; lower the rate, then --resume")
        log.write(place.step, "step", values, place.seconds)
        if place.step % config.validate_every and place.step != config.steps:
            continue
        metrics = _floats(task.validate(state))
        log.write(place.step, "validation", metrics, time.perf_counter() - started)
        place.stale += 1
        if place.best is None or metrics[SCORE] > place.best:
            place.best, place.stale = metrics[SCORE], 0
            if processes.first():
                task.export(state, {"step": place.step, **metrics}, out)
        minutes = (config.steps - place.step) * place.seconds / place.step / 60
        if processes.first():
            store.save(state, place)
            print(f"step {place.step:5d}  {_words(values)}  |  validation {_words(metrics)}  |  {minutes:.0f} min left")
        if place.stale >= config.patience:
            break
    if place.stale >= config.patience and processes.first():
        print(f"stopped: {place.stale} validations without a better score")
    return metrics


def check(config: LoopConfig) -> None:
    """Raises ValueError that names the key which no training can have."""
    for name in ("steps", "validate_every", "patience"):
        if getattr(config, name) < 1:
            raise ValueError(f"loop.{name} is {getattr(config, name)}: needs 1 or more")
    if config.tensorboard and importlib.util.find_spec("tensorboardX") is None:
        raise ValueError('loop.tensorboard needs tensorboardX: pip install "ebjax[train]"')


def _numbers(config: LoopConfig) -> dict[str, Any]:
    return {f"loop.{name}": getattr(config, name) for name in ("steps", "validate_every", "patience")}


class Checkpoints:
    """Orbax checkpoints in a folder, with the settings they were made under."""

    def __init__(self, folder: Path, settings: dict[str, Any]):
        self.folder, self.settings = folder.absolute(), json.loads(json.dumps(settings, default=str))

    def steps(self) -> list[int]:
        """Of all whole checkpoints, in order."""
        if not self.folder.is_dir():
            return []
        return sorted(int(path.name) for path in self.folder.iterdir() if path.name.isdigit())

    def save(self, state: State, place: _Place) -> None:
        """Writes one whole; only then are all but it and the one before removed."""
        with whole_folder(self.folder / str(place.step)) as folder:
            try:
                with _checkpointer() as writer:
                    writer.save(folder / "state", jax.tree.map(np.asarray, state))
            except Exception as fault:  # Orbax raises whatever its storage raises
                raise OSError(f"{self.folder}: step {place.step} cannot be kept ({_reason(fault)})") from fault
            with whole_file(folder / PLACE) as file:
                json.dump({"place": dataclasses.asdict(place), "settings": self.settings}, file, indent=1)
        for step in self.steps()[:-2]:
            shutil.rmtree(self.folder / str(step))
        for left_over in self.folder.glob(".*.partial"):
            shutil.rmtree(left_over)

    def load(self, like: State) -> tuple[State, _Place]:
        """The latest one; `like` and the beginning where there is none.

        Raises:
          ValueError: it cannot be read, or is of other settings.
        """
        if not (steps := self.steps()):
            return like, _Place()
        folder = self.folder / str(steps[-1])
        try:
            told = json.loads((folder / PLACE).read_text(encoding="utf-8"))
            place, settings = _Place(**told["place"]), told["settings"]
        except (OSError, ValueError, KeyError, TypeError):
            raise self._broken(folder, steps) from None
        for key in sorted({*settings, *self.settings}):
            if settings.get(key) != self.settings.get(key):
                raise ValueError(
                    f"{folder}: was trained with {key} {settings.get(key)}, the config says {self.settings.get(key)}; "
                    "restore the config, or give another --out"
                )
        try:
            with _checkpointer() as reader:
                state = reader.restore(folder / "state", jax.tree.map(np.asarray, like))
        except Exception as fault:  # Orbax raises whatever its storage raises
            raise self._broken(folder, steps) from fault
        return state, place

    def _broken(self, folder: Path, steps: list[int]) -> ValueError:
        before = f"to go on from step {steps[-2]}" if len(steps) > 1 else "and start again"
        return ValueError(f"{folder}: this checkpoint cannot be read; delete that folder {before}")


@contextlib.contextmanager
def _checkpointer() -> Iterator[Any]:
    """Orbax's, for this process alone (all have the same state), without the tracebacks that it logs of its threads."""
    import orbax.checkpoint as ocp

    own, log = jax.process_index(), logging.getLogger("absl")
    alone = ocp.options.MultiprocessingOptions(primary_host=own, active_processes={own})
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with ocp.StandardCheckpointer(multiprocessing_options=alone) as checkpointer:
            yield checkpointer
    finally:
        log.setLevel(level)


def _reason(fault: Exception) -> str:
    """The system's own words in an error of the storage: "No space left on device"."""
    text = " ".join(str(fault).split())
    words = [os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EROFS)]
    return next((known for known in words if known in text), text[:200] or type(fault).__name__)


def _floats(metrics: dict[str, Any]) -> Metrics:
    return {name: float(value) for name, value in metrics.items()}


def _words(metrics: Metrics) -> str:
    return "  ".join(f"{name} {value:.3f}" for name, value in metrics.items())
