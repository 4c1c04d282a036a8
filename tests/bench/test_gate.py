"""The gate: what it says and returns, on made up times; that every part can be timed."""

import json
import os
import time

import numpy as np
import pytest

from ebjax.bench import gate
from ebjax.bench.__main__ import main
from ebjax.bench.baseline import BASELINE, Baseline, machine, read_baseline, write_baseline
from ebjax.bench.gate import GateConfig
from ebjax.bench.measure import Measured, measure, one_core, slowed, timed
from ebjax.bench.parts import PARTS, Pair

RATIOS = {name: 0.5 for name in PARTS}


@pytest.fixture
def baseline(tmp_path):
    """A baseline of this machine, by which every part takes half of its reference's time."""
    path = tmp_path / "baseline.json"
    write_baseline(path, Baseline(machine(), 15, RATIOS))
    return path


@pytest.fixture(autouse=True)
def times(monkeypatch):
    """What is measured in place of times: half, one noise for both sides, and another of a hundredth for each.

    No reference runs, so that none needs to be there.
    """

    def made_up(names, turns, slow_downs):
        rng = np.random.default_rng(0)
        load, ours, theirs = rng.exponential(1.0, turns) + 1, *np.exp(0.01 * rng.standard_normal((2, turns)))
        return {name: Measured(10 * load * ours * slow_downs.get(name, 1.0), 20 * load * theirs) for name in names}

    monkeypatch.setattr(gate, "measure", made_up)
    monkeypatch.setattr(gate, "find_spec", lambda name: name)


def refused(capsys, *argv, code=2):
    with pytest.raises(SystemExit) as stop:
        main([*map(str, argv)])
    assert stop.value.code == code
    return capsys.readouterr()


def test_an_unchanged_run_passes(capsys, baseline):
    main(["--gate", "--baseline", str(baseline)])
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()[1:]] == list(PARTS)
    assert out.count("as before") == len(PARTS) and "note" not in err


def test_a_slower_part_fails_and_is_named(capsys, baseline):
    out, err = refused(capsys, "--gate", "--baseline", baseline, "--slow-down", "warp=1.25", "solver=1.1", code=1)
    assert err == f"error: slower than {baseline} by more than 15%: warp\n"
    said = {line.split()[0]: line.rpartition(", ")[2] for line in out.splitlines()[1:]}
    assert said == {name: "slower" if name == "warp" else "as before" for name in PARTS}


def test_a_faster_part_is_said_and_passes(capsys, baseline):
    write_baseline(baseline, Baseline(machine(), 15, {**RATIOS, "warp": 0.7}))
    main(["warp", "--gate", "--baseline", str(baseline)])
    assert capsys.readouterr().out.rstrip().endswith(", faster")


def test_without_gate_times_and_ratios_are_printed(capsys):
    main(["warp", "solver"])
    found = gate.measure(["warp"], GateConfig().turns, {})["warp"]
    values = [f"{np.median(side):.2f}" for side in found] + [f"{np.median(found.ratios):.4f}"]
    lines = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [line[:4] for line in lines] == [[name, *values] for name in ("warp", "solver")]
    assert all(len(line) == 6 and line[4] <= line[3] <= line[5] for line in lines)


def test_what_is_written_is_read_again(capsys, tmp_path):
    path = tmp_path / "new" / "baseline.json"
    main(["--write-baseline", "--baseline", str(path), "--turns", "17"])
    assert f"wrote {path}" in capsys.readouterr().out
    found = read_baseline(path, machine()["processor"])
    assert found.machine == machine() and found.turns == 17 and found.ratios.keys() == PARTS.keys()
    main(["--gate", "--baseline", str(path)])


def test_another_library_is_said(capsys, baseline):
    write_baseline(baseline, Baseline({**machine(), "numpy": "1.0"}, 15, RATIOS))
    main(["warp", "--gate", "--baseline", str(baseline)])
    assert capsys.readouterr().err.startswith("note: numpy: the baseline's is 1.0, this is ")


def test_another_processor_has_a_baseline_of_its_own(capsys, tmp_path, baseline):
    z80, here = {**machine(), "processor": "Z80"}, machine()["processor"]
    write_baseline(baseline, Baseline(z80, 15, {**RATIOS, "warp": 0.1}))
    main(["warp", "--gate", "--baseline", str(baseline)])
    assert capsys.readouterr().err == "" and read_baseline(baseline, "Z80").ratios["warp"] == 0.1
    write_baseline(tmp_path / "other.json", Baseline(z80, 15, RATIOS))
    err = refused(capsys, "warp", "--gate", "--baseline", tmp_path / "other.json").err
    assert f"no baseline of this processor ({here})" in err and "--write-baseline, which keeps the others" in err


def test_a_missing_reference_is_said(capsys, baseline, monkeypatch):
    find = gate.find_spec
    monkeypatch.setattr(gate, "find_spec", lambda name: None if name == "faiss" else find(name))
    main(["warp", "search", "--gate", "--baseline", str(baseline)])
    out, err = capsys.readouterr()
    assert err == 'left out: search: faiss is not installed; pip install "ebjax[oracle]"\n'
    assert len(out.splitlines()) == 2
    for flags in (["search"], ["--write-baseline", "--baseline", baseline]):
        assert 'pip install "ebjax[oracle]"' in refused(capsys, *flags).err


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["warps"], "no part 'warps'; there are slam, solver"),
        (["--gate", "--turns", "14"], "--turns is 14; give 15 or more"),
        (["--write-baseline", "--gate"], "without --gate"),
        (["warp", "--write-baseline"], "name none"),
        (["--slow-down", "warp"], "--slow-down warp: give PART=TIMES"),
        (["--slow-down", "warps=2"], "one of slam, solver"),
        (["--slow-down", "warp=nan"], "a number from 1 to 100"),
        (["warp", "--slow-down", "solver=2"], "one of warp, and"),
    ],
)
def test_bad_options_are_one_line(capsys, flags, said):
    err = refused(capsys, *flags).err
    assert said in err and len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there is no baseline"),
        ("{", "Expecting property name"),
        ("{}", "the file must be a list"),
        ("[[]]", "an object of machine, ratios, turns"),
        (json.dumps([{"machine": {}, "turns": 15, "ratios": {"warp": 0}}]), "warp: the ratio must be a number above 0"),
        (json.dumps([{"machine": {}, "turns": 15, "ratios": [1]}]), "ratios must be an object"),
        (json.dumps([{"machine": {"a": 1}, "turns": 15, "ratios": {}}]), "machine must be an object of texts"),
        (json.dumps([{"machine": machine(), "turns": 15, "ratios": {"solver": 1.0}}]), "it has no warp"),
    ],
)
def test_a_bad_baseline_is_one_line(capsys, tmp_path, text, said):
    path = tmp_path / "baseline.json"
    if text is not None:
        path.write_text(text)
    err = refused(capsys, "warp", "--gate", "--baseline", path).err
    assert f"error: {path}: " in err and said in err and "--write-baseline" in err and len(err.splitlines()) == 1


def test_the_baselines_that_come_along_have_every_part():
    processors = [one["machine"]["processor"] for one in json.loads(BASELINE.read_text())]
    assert all(read_baseline(BASELINE, one).ratios.keys() == PARTS.keys() for one in processors) and processors


def test_a_turn_s_calls_are_averaged():
    found = timed({"busy": Pair(lambda: busy(0.002), lambda: busy(0.001), calls=3)}, 6)["busy"]
    assert found.ratios.shape == (6,) and (found.ours_ms >= 2).all() and (found.reference_ms >= 1).all()


def busy(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_a_slowed_call_takes_longer_and_answers_the_same():
    start = time.process_time()
    assert slowed(lambda: busy(0.01) or 7, 3.0)() == 7
    assert time.process_time() - start >= 0.03


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "slam")) for name in PARTS])
def test_every_part_runs(name):
    if (needs := PARTS[name].needs) is not None:
        pytest.importorskip(needs)
    found = timed({name: PARTS[name].make()._replace(calls=1)}, 1)[name]
    assert found.ratios.shape == (1,) and found.ratios[0] > 0


@pytest.mark.slow
def test_a_part_is_measured_in_a_process_of_its_own():
    cores = os.sched_getaffinity(0)
    found = measure(["warp", "matching"], 2, {"warp": 5.0})
    assert found.keys() == {"warp", "matching"} and (found["warp"].ratios > 1.5).all()
    assert os.sched_getaffinity(0) == cores


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system keeps no process to a core")
def test_one_core_is_given_back():
    cores = os.sched_getaffinity(0)
    with one_core():
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == cores
