import importlib
import sys
from pathlib import Path

import pytest

from ebjax.command import setup_jax

sys.path.insert(0, str(Path(__file__).parent))
small_run = importlib.import_module("small_run")


class Whole:
    """A run that was kept in a map from end to end: the map's file, what came out, and its keyframes' arrays."""

    def __init__(self, path):
        setup_jax()
        self.path = path
        with small_run.opened(path) as store:
            self.run = small_run.finished(store)
            self.result = small_run.result(self.run)
            self.arrays = [store.arrays(row) for row in range(len(store))]
            self.names = store.file.keyframes().name

    def keep(self, store, rows):
        """Keeps some of them in another map, as a run does that is killed then."""
        for row in rows:
            store.keep(self.arrays[row], self.names[row])


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    return Whole(tmp_path_factory.mktemp("maps") / "whole.ebmap")
