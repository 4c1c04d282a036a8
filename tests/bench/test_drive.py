"""What the bench says of a drive, from made up keyframes, and from a small run."""

import json
from itertools import islice

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.bench import __main__ as bench
from ebjax.bench import drive
from ebjax.bench.curves import running
from ebjax.bench.programs import counted
from ebjax.bench.timeline import WARM, Timeline
from ebjax.slam.drive import frames_of
from ebjax.slam.frame import Update
from ebjax.slam.mapper import Mapper

Image = pytest.importorskip("PIL.Image")


def update(k, keyframe, ms=10.0):
    return Update(k, float(k), keyframe, np.zeros(3), True, None, np.eye(3), milliseconds=ms)


def test_programs_are_counted_where_they_are_asked_for():
    with counted() as found:
        jax.jit(lambda x: x * 3.25 + 1)(jnp.arange(7.0)).block_until_ready()
    assert found.asked.total() >= 1
    assert found.here == found.asked.total() and 0 <= found.compiled <= found.asked.total()
    before = found.asked.total()
    jax.jit(lambda x: x * 4.25 + 1)(jnp.arange(7.0)).block_until_ready()
    assert found.asked.total() == before


def test_a_timeline_tells_of_what_came_after_the_start():
    with counted() as programs:
        timeline = Timeline(programs)
        for k in range(WARM + 200):
            timeline.told(update(k, k if k % 2 == 0 else None, 1000.0 if k < WARM else 10.0 + (k == 200)))
    assert len(timeline.rows) == (WARM + 200) // 2
    head, _, add, *_ = timeline.lines()
    assert f"{len(timeline.rows)} keyframes, the first {WARM} left out" in head
    assert add.split()[2:6] == ["10.0", "10.0", "10.3", "11.0"]
    assert json.loads(json.dumps(timeline.arrays()))["keyframe"][-1] == WARM + 198


def test_few_keyframes_have_no_figures():
    with counted() as programs:
        timeline = Timeline(programs)
        timeline.told(update(0, 0))
    assert "too few" in timeline.lines()[0]


def test_a_running_percentile_looks_back_only():
    values = np.random.default_rng(0).uniform(size=250)
    assert running(values, 50)[249] == pytest.approx(np.median(values[150:250]))
    assert running(values, 50)[0] == values[0]


@pytest.mark.slow
def test_a_run_is_driven_into_a_map(rendered, tmp_path, capsys):
    out = tmp_path / "bench"
    bench.main(["drive", str(rendered), "--out", str(out)])
    said = capsys.readouterr().out
    assert "kB a keyframe" in said and "closures" in said
    with Image.open(out / "timeline.png") as drawn:
        assert drawn.size[0] > 600
    assert len(json.loads((out / "timeline.json").read_text())["add_ms"]) > 20
    with pytest.raises(SystemExit) as stopped:
        bench.main(["drive", str(rendered), "--out", str(out)])
    assert stopped.value.code == 2
    assert "map.ebmap: holds an earlier drive" in capsys.readouterr().err


@pytest.mark.slow
def test_what_was_measured_until_it_is_stopped_is_told(rendered, tmp_path, capsys, monkeypatch):
    def stopped(recording, camera, view, config, *, keep, watch):
        engine = Mapper(camera, config, view=view, recording=recording, store=keep(camera, view(camera), None))
        told = watch(engine)
        for frame in islice(frames_of(recording, config), 30):
            told(engine.add(frame))
        raise KeyboardInterrupt

    monkeypatch.setattr(drive, "run_pipeline", stopped)
    with pytest.raises(SystemExit):
        bench.main(["drive", str(rendered), "--out", str(tmp_path / "bench")])
    assert "30 keyframes are too few" in capsys.readouterr().out
    assert len(json.loads((tmp_path / "bench" / "timeline.json").read_text())["wall_ms"]) == 30
