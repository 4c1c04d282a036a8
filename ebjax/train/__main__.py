"""Learns on synthetic floors, end to end if wanted, or from a run of one's own: the config says which task.

python -m ebjax.train --config configs/train/floornet.yaml --out runs/floornet [--resume]
"""

import dataclasses
import importlib
import itertools
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
import yaml

from ebjax.command import run
from ebjax.io.text import read_text
from ebjax.io.yaml_text import parse_yaml
from ebjax.train import processes

TASKS = {
    "floornet": "ebjax.train.floornet",
    "finetune": "ebjax.train.finetune",
    "words": "ebjax.train.words",
    "throughput": "ebjax.train.throughput",
    "calibrate": "ebjax.train.calibrate",
    "end_to_end": "ebjax.train.end_to_end",
}
"""Each is a module with a dataclass `Config` and `run(config, out, resume=)`. A new one is a file and a line here."""
SHARED = {"floornet"}
"""Tasks whose steps several processes can share."""


def task_of(argv: list[str]) -> str:
    """The task that --task or the file of --config names; floornet where neither does.

    Raises:
      ValueError: there is no such task.
      OSError: the file cannot be read.
    """
    named, source = None, "--task"
    for flag, value in itertools.pairwise(argv):
        if flag == "--task":
            return _known(value, source)
        if flag == "--config":
            try:
                values = parse_yaml(read_text(value))
            except yaml.YAMLError:
                continue  # told with its line when the whole file is read
            named, source = (values.get("task") if isinstance(values, dict) else None), f"{value}: task"
    return "floornet" if named is None else _known(named, source)


def _known(name: Any, source: str) -> str:
    if name not in TASKS:
        raise ValueError(f"{source} {name!r} is unknown; choose one of {', '.join(TASKS)}")
    return name


def command(name: str) -> type[Any]:
    """The options of a task and of every training."""
    module = importlib.import_module(TASKS[name])
    out = Annotated[Path, tyro.conf.arg(help="Folder for weights, log and checkpoints.")]
    resume = Annotated[bool, tyro.conf.arg(help="Go on from the latest checkpoint in --out.")]
    count = Annotated[int, tyro.conf.arg(help="How many processes train together, all by this command.")]
    which = Annotated[int, tyro.conf.arg(help="Which of them this one is, from 0.")]
    where = Annotated[str, tyro.conf.arg(help="HOST:PORT of process 0, free and within reach of all.")]
    made = dataclasses.make_dataclass(
        "Config",
        [
            ("task", Literal[name], dataclasses.field(default=name)),  # type: ignore[valid-type]
            ("out", out, dataclasses.field(default=Path("runs/train"))),
            ("resume", resume, dataclasses.field(default=False)),
            ("processes", count, dataclasses.field(default=1)),
            ("process", which, dataclasses.field(default=0)),
            ("coordinator", where, dataclasses.field(default="")),
        ],
        bases=(module.Config,),
        frozen=True,
        kw_only=True,
    )
    made.__doc__ = module.Config.__doc__
    return made


def main(config: Any) -> None:
    """Trains."""
    module = importlib.import_module(TASKS[config.task])
    own = {field.name: getattr(config, field.name) for field in dataclasses.fields(module.Config)}
    if config.processes > 1 and config.task not in SHARED:
        raise ValueError(f"--processes is {config.processes}: the task {config.task} trains in one process")
    processes.join(config.processes, config.process, config.coordinator)
    with processes.together():
        module.run(module.Config(**own), config.out, resume=config.resume)
        processes.wait("end")


def _main() -> None:
    try:
        options = command(task_of(sys.argv[1:]))
    except OSError as fault:
        print(f"error: {fault.filename}: {str(fault.strerror).lower()}", file=sys.stderr)
        sys.exit(2)
    except ValueError as fault:
        print(f"error: {fault}", file=sys.stderr)
        sys.exit(2)
    try:
        run(main, options)
    except SystemExit as stop:
        processes.leave(stop.code)
        raise


if __name__ == "__main__":
    _main()
