import contextlib
import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from ebjax.command import run
from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig
from ebjax.slam.__main__ import Config, main
from ebjax.worlds.render import render_sequence


@pytest.fixture(scope="session")
def rendered(made_once):
    """A synthetic corridor, 6 m out and back, rendered once."""

    def render(folder):
        render_sequence(CorridorConfig(seed=3, robot=RobotConfig(distance_m=6.0)), folder / "sequence")

    return made_once("rendered", render) / "sequence"


class Done(NamedTuple):
    """A run of the command: its folder, the map that it is kept in, its metrics, what it printed."""

    out: Path
    map: Path
    metrics: dict[str, Any]
    printed: str


@pytest.fixture(scope="session")
def done(rendered, made_once):
    """The rendered corridor, run once into a map."""

    def drive(folder):
        flags = ["--out", str(folder / "run"), "--map", str(folder / "building.ebmap")]
        with open(folder / "printed", "w") as printed, contextlib.redirect_stdout(printed):
            run(main, Config, [str(rendered), *flags])

    folder = made_once("done", drive)
    metrics = json.loads((folder / "run" / "metrics.json").read_text())
    return Done(folder / "run", folder / "building.ebmap", metrics, (folder / "printed").read_text())


@pytest.fixture
def sequence(rendered, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(rendered, tmp_path / "sequence")
