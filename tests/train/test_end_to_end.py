"""The end-to-end task in the small: what a part's optimiser moves, runs kept in a folder, the whole task."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry.optics import Optics, with_optics
from ebjax.slam.soft import Parameters
from ebjax.train.end_to_end import TUNED, Config, check, corrected, mounting, optimiser, run, untuned
from ebjax.train.end_to_end_runs import WorldConfig, corridor, load_run
from ebjax.train.loop import LoopConfig

SMALL = WorldConfig(distance_m=2.0, step_m=0.4, turn_step_deg=60.0, width_px=160, texel_m=0.02)


@pytest.mark.parametrize("part", TUNED)
def test_only_what_is_tuned_moves(part):
    config = Config(loop=LoopConfig(steps=5))
    at = Parameters(mounting(0, 0, 0), untuned(4, 0), optics=Optics(jnp.zeros(4), jnp.zeros(5)))
    adam = optimiser(config, part)
    change, _ = adam.update(jax.tree.map(jnp.ones_like, at), adam.init(at), at)
    leaves = {
        "camera": change.mounting.height_m,
        "lens": change.optics.coefficients,
        "words": change.words.centres,
        "threshold": change.words.threshold,
    }
    rates = {name: getattr(config, f"{name}_rate") for name in leaves}
    assert not change.optics.intrinsics.any()
    for name, leaf in leaves.items():
        np.testing.assert_allclose(leaf, -rates[name] if name in TUNED[part] else 0, rtol=1e-4)


@pytest.mark.slow
def test_the_task_tunes_tests_and_writes(tmp_path, capsys):
    config = Config(
        training=("terrazzo",),
        held_out=("terrazzo",),
        world=SMALL,
        clusters=4,
        loop=LoopConfig(1, 1),
        gap_s=2.0,
        candidates=1,
    )
    run(config, tmp_path, resume=False)
    told = json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))
    rows = told["rows"]
    assert set(config.parts) < set(rows) and told["config"]["clusters"] == 4
    for row in rows.values():
        assert np.isfinite(row["ate_rmse_m"]["held out"]).all()
    assert rows["homography"]["parameters"]["pitch_deg"] != 0 == rows["aggregation"]["parameters"]["pitch_deg"]
    lines = (tmp_path / "table.md").read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("| ") for line in lines) == len(rows) + 1 and lines[-1] in capsys.readouterr().out
    log = (tmp_path / "both" / "log.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["kind"] for line in log] == ["validation", "step", "validation"]


@pytest.mark.slow
def test_a_lens_that_is_believed_wrong_and_what_undoes_it(tmp_path):
    world = corridor(dataclasses.replace(SMALL, camera="phone-raw"), "terrazzo", 1)
    true, off = (load_run(world, mounting(0, 0, 0), tmp_path, share).camera for share in (0.0, 0.2))
    assert true.lens.model == off.lens.model == "plumb_bob"
    assert float(off.lens.coefficients[0]) == pytest.approx(1.2 * float(true.lens.coefficients[0]))
    np.testing.assert_array_equal(off.lens.coefficients[1:], true.lens.coefficients[1:])
    undone = with_optics(off, corrected(off, 0.2))
    np.testing.assert_allclose(undone.lens.coefficients, true.lens.coefficients, rtol=1e-12)


@pytest.mark.parametrize(("changes", "key"), [({"parts": ("lens",)}, "parts"), ({"distortion_off": 0.2}, "distort")])
def test_a_lens_is_tuned_only_where_there_is_one(tmp_path, changes, key):
    with pytest.raises(ValueError, match=f"{key}.* asks for a lens, but world.camera p3dx-d435 has none"):
        run(Config(world=SMALL, **changes), tmp_path / "out", resume=False)
    check(Config(world=dataclasses.replace(SMALL, camera="phone-raw"), **changes))


@pytest.mark.slow
def test_runs_are_kept_and_made_again_where_damaged(tmp_path):
    world = corridor(SMALL, "terrazzo", 1)
    once = load_run(world, mounting(0, 0, 0), tmp_path)
    file = tmp_path / "terrazzo_1.npz"
    before = file.stat().st_mtime_ns
    off = load_run(world, mounting(3, 1, 0.05), tmp_path)
    assert file.stat().st_mtime_ns == before
    assert float(off.camera.base_from_camera[2, 3] - once.camera.base_from_camera[2, 3]) == pytest.approx(0.05)
    file.write_bytes(file.read_bytes()[:1000])
    again = load_run(world, mounting(0, 0, 0), tmp_path)
    np.testing.assert_array_equal(once.images, again.images)
    assert once.images.shape[1:] == (120, 160, 1) and 0.1 < float(once.images.mean()) < 0.9
