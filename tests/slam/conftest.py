import shutil

import pytest

from ebjax.floors.robot import RobotConfig
from ebjax.floors.sequence import CorridorConfig
from ebjax.worlds.render import render_sequence


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """A synthetic corridor, 6 m out and back, rendered once."""
    out = tmp_path_factory.mktemp("rendered") / "sequence"
    render_sequence(CorridorConfig(seed=3, robot=RobotConfig(distance_m=6.0)), out)
    return out


@pytest.fixture
def sequence(rendered, tmp_path):
    """A copy that a test may spoil."""
    return shutil.copytree(rendered, tmp_path / "sequence")
