import numpy as np
import pytest

from ebjax.models.weights import load_weights
from ebjax.train.floornet import WEIGHTS, Config, task
from ebjax.train.loop import LoopConfig
from ebjax.train.views import PITCH_PX

SMALL = Config(loop=LoopConfig(steps=20), canvases=9, held_out=2, floors=2, places=2, side_px=32, dimension=8, warmup=1)


@pytest.mark.slow
def test_steps_change_every_layer_and_say_how_they_went(tmp_path):
    side = 3 * PITCH_PX + 40
    canvases = np.random.default_rng(0).uniform(0.1, 0.9, (SMALL.canvases, side, side, 3)).astype(np.float16)
    made = task(SMALL, canvases)
    made.export(made.state, {"step": 0}, tmp_path)
    before = load_weights(tmp_path / WEIGHTS)[1]
    state = made.state
    for number in range(3):
        state, metrics = made.step(state, number)
        assert np.isfinite([float(metrics[name]) for name in ("loss", "local", "gradient")]).all()
    made.export(state, {"step": 3}, tmp_path)
    after = load_weights(tmp_path / WEIGHTS)[1]
    assert before.keys() == after.keys()
    assert [name for name in before if np.array_equal(before[name], after[name])] == []
