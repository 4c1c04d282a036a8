"""Every test runs in float64 with strict ranks; the shared data sets are found through EBJAX_DATA."""

import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

MAPS, MOST_MAPS = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
DATA = Path(os.environ.get("EBJAX_DATA", Path(__file__).parents[2] / "shared" / "data"))


@pytest.fixture(scope="module", autouse=True)
def room_for_programs():
    """Drops compiled programs long before their memory maps reach Linux' limit for a process."""
    yield
    if MOST_MAPS.exists() and 4 * MAPS.read_bytes().count(b"\n") > int(MOST_MAPS.read_text()):
        jax.clear_caches()


@pytest.fixture
def data():
    """Returns a function that gives the path of a shared data set, or skips where it is absent."""

    def find(name: str) -> Path:
        path = DATA / name
        if not path.exists():
            pytest.skip(f"{name} is not in {DATA}; set EBJAX_DATA to the folder that holds it")
        return path

    return find
