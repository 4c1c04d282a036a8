import importlib

import numpy as np
import pytest
from small_run import assert_same, held

kill = importlib.import_module("kill")


@pytest.mark.slow
def test_killed_at_five_moments_and_gone_on_with(whole, tmp_path):
    path, rng, kept = tmp_path / "a.ebmap", np.random.default_rng(), 0
    for _ in range(5):
        # Seldom the end: what is left of the run is longer than this.
        found = kill.killed(path, rng, 12)
        assert found is None
        assert held(path) >= kept
        kept = held(path)
    assert 0 < kept < len(whole.arrays)
    assert_same(kill.to_its_end(path), whole.result)
