"""The worlds of the tables: a YAML file each, rendered once, and rendered again when the file says something else."""

import dataclasses
import shutil
from pathlib import Path

import ebjax
from ebjax.config import load_config
from ebjax.floors.sequence import check
from ebjax.io.atomic import whole_file
from ebjax.worlds.render import Config as WorldConfig
from ebjax.worlds.render import render_sequence

QUICK_STEP_M, QUICK_WAY_M = 0.4, 12.0
"""Of a quick world: distance between two frames, at least, and length of a straight way out, at most."""


def default_folder() -> Path:
    """configs/worlds of the checkout."""
    return Path(ebjax.__file__).parents[1] / "configs" / "worlds"


def read_world(folder: Path, name: str, *, quick: bool) -> WorldConfig:
    """What a world is like; a quick one has fewer frames, and a straight way is cut short.

    Raises:
      ValueError: there is no such file, or it is not understood, or no world can be so; names file and key.
    """
    path = folder / f"{name}.yaml"
    if not path.is_file():
        raise ValueError(f"{path}: no such file; --worlds names the folder with a NAME.yaml for every set")
    config = load_config(path, WorldConfig)
    try:
        check(config)
    except ValueError as fault:
        raise ValueError(f"{path}: {fault}") from None
    if quick:
        robot = config.robot
        step_m, distance_m = max(robot.step_m, QUICK_STEP_M), min(robot.distance_m, QUICK_WAY_M)
        config = dataclasses.replace(config, robot=dataclasses.replace(robot, step_m=step_m, distance_m=distance_m))
    return config


def settings(config: WorldConfig, name: str) -> str:
    """All that the world's images follow from."""
    return f"ebjax {ebjax.__version__}: {dataclasses.replace(config, out=Path(name))!r}"


def render(config: WorldConfig, name: str, folder: Path) -> Path:
    """The folder of the world's sequence, rendered if it is not there as `config` says."""
    out, record, text = folder / name, folder / f"{name}.txt", settings(config, name)
    if (out / "rgb.txt").is_file() and record.is_file() and record.read_text(encoding="utf-8") == text:
        return out
    record.unlink(missing_ok=True)
    for left in (out, *folder.glob(f".{name}.*.partial")):
        shutil.rmtree(left, ignore_errors=True)
    print(f"rendering {name}", flush=True)
    render_sequence(config, out)
    with whole_file(record) as file:
        file.write(text)
    return out
