"""A training that takes no time, as a module, as a task and as a program: toy_training.py FLAGS of ebjax.train.

In a program, $TOY_KILL says where the process ends by SIGKILL: at a step's number, "saving" (before the second
checkpoint has its name) or "removing" (before the first is gone).
"""

import dataclasses
import json
import os
import shutil
import signal
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from ebjax.train import __main__ as command
from ebjax.train import loop, processes

STEPS, EVERY = 12, 3


@dataclasses.dataclass(frozen=True)
class Config:
    """Trains the toy."""

    rate: float = 0.05
    """Of gradient descent."""
    size: int = 2
    """Columns of the weights."""
    patience: int = 10
    """As in `loop`."""


@jax.jit
def _step(state, rows):
    rows = processes.map_rows(jnp.tanh, rows)
    loss, gradient = jax.value_and_grad(lambda s: jnp.mean((rows @ s["w"] - 1) ** 2))(state)
    return processes.kept_whole(jax.tree.map(lambda a, b: a - 0.05 * b, state, gradient)), loss


def _rows(number):
    return processes.share(np.random.default_rng(number).standard_normal((8, 6)).astype(np.float32))


def task(config, better=None, killed=""):
    """Least squares; `better` gives each validation's score in place of the loss."""
    scores = iter(better or ())

    def validate(state):
        loss = float(_step(state, _rows(999))[1])
        return {"score": next(scores, -loss)}

    def step(state, number):
        if killed == str(number):
            _kill()
        state, loss = _step(state, _rows(number))
        return state, {"loss": loss}

    def export(state, metrics, out):
        (out / "best.json").write_text(json.dumps(metrics))

    # Random, for Orbax packs what repeats itself.
    first = {"w": np.random.default_rng(0).standard_normal((6, config.size)).astype(np.float32)}
    return loop.Task(first, step, validate, export, {"rate": config.rate, "size": config.size})


def fit(out, *, resume=False, better=None, steps=STEPS, **options):
    """Trains the toy in this process."""
    config = Config(**options)
    return loop.fit(task(config, better), loop.LoopConfig(steps, EVERY, config.patience), out, resume=resume)


def run(config, out, *, resume):
    """What `ebjax.train` calls."""
    killed = os.environ.get("TOY_KILL", "")
    if killed == "saving":
        rename = Path.rename
        Path.rename = lambda path, new: _kill() if str(new).endswith("/6") else rename(path, new)
    elif killed == "removing":
        remove = shutil.rmtree
        shutil.rmtree = lambda path, *a, **k: _kill() if Path(path).name.isdigit() else remove(path, *a, **k)
    loop.fit(task(config, killed=killed), loop.LoopConfig(STEPS, EVERY, config.patience), out, resume=resume)


def _kill():
    os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    command.TASKS["toy"] = "toy_training"
    command.SHARED.add("toy")
    sys.argv[1:1] = ["--task", "toy"]
    command._main()
