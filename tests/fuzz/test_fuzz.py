"""A short campaign over every reader, and the proof that the harness sees what must not be."""

import json
import tempfile

import pytest

from .campaign import KEPT, Tally, campaign, found, replay, table
from .mutate import mutated
from .planted import PLANTED
from .readers import READERS
from .watch import Worker

INPUTS, SEED = 100, 0
FAULTS = {
    "planted-key": "KeyError", "planted-lines": "message of several lines", "planted-silent": "message of no line",
    "planted-repr": "message with a repr", "planted-warning": "RuntimeWarning", "planted-deep": "RecursionError",
    "planted-crash": "crash", "planted-endless": "timeout", "planted-large": "MemoryError",
    "planted-resident": "memory",
}  # fmt: skip
RIGHT = {"planted-good": "result", "planted-value": "ValueError", "planted-os": "OSError"}


@pytest.mark.slow
@pytest.mark.parametrize("group", ["host", "jax"])
def test_every_damaged_input_gives_a_result_or_one_line(group, tmp_path):
    readers = [name for name, reader in READERS.items() if reader.needs_jax == (group == "jax")]
    tallies = campaign(readers, [range(INPUTS)], SEED, tmp_path / "kept")
    faults = [line for line in found(tallies) if not line.startswith("weak")]
    assert not faults, "\n".join(faults)
    assert all(tally.inputs == INPUTS for tally in tallies.values())
    for reader, tally in tallies.items():  # seeds that no mutation spoils, or none that it does, test nothing
        assert 0 < tally.outcomes["result"] < INPUTS, f"{reader}: {tally.outcomes}"
    assert len(table(tallies)) == len(readers) + 1


def test_the_count_of_inputs():
    assert len(READERS) * INPUTS >= 2000


@pytest.mark.slow
def test_the_harness_sees_what_must_not_be(tmp_path):
    seen = {}
    with Worker("host", tmp_path) as worker:
        for name in PLANTED:
            verdict = worker.read(name, tmp_path)
            seen[name] = [kind for kind, _, _ in verdict["faults"]], verdict["outcome"], len(verdict["weak"])
        assert worker.read("planted-good", tmp_path)["outcome"] == "result"
    assert {name for name, (kinds, _, _) in seen.items() if kinds} == set(FAULTS)
    assert all(kind in seen[name][0] for name, kind in FAULTS.items()), seen
    assert {name: outcome for name, (_, outcome, _) in seen.items() if name in RIGHT} == RIGHT
    assert seen["planted-unnamed"] == ([], "ValueError", 1)
    assert set(PLANTED) == {*FAULTS, *RIGHT, "planted-unnamed"}


@pytest.mark.parametrize("reader", READERS)
def test_inputs_depend_on_the_seed_alone(reader):
    seeds, again = READERS[reader].inputs(), READERS[reader].inputs()
    inputs = [mutated(reader, seeds, 3, number) for number in range(20)]
    assert inputs == [mutated(reader, again, 3, number) for number in range(20)]
    assert inputs != [mutated(reader, seeds, 4, number) for number in range(20)]
    assert sum(made in seeds for made in inputs) < 10


def test_a_finding_is_kept_and_can_be_read_again(tmp_path, monkeypatch):
    verdict = {"outcome": "fault", "faults": [["KeyError", "io/x.py:1", "'x'"]], "weak": [], "ms": 1.0, "bytes": 0}
    monkeypatch.setattr(Worker, "read", lambda *_: verdict)
    tallies = campaign(["truth"], [range(5)], 0, tmp_path)
    assert tallies["truth"].findings == {("KeyError", "io/x.py:1"): 5}
    kept = sorted(tmp_path.iterdir())
    assert len(kept) == KEPT
    facts = json.loads((kept[0] / "finding.json").read_text())
    assert facts["reader"] == "truth" and facts["replay"].endswith(str(kept[0]))
    monkeypatch.undo()
    assert replay(kept[0])["faults"] == []


def test_nothing_is_left_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    campaign(["bag", "config"], [range(10)], 1)
    assert list(tmp_path.iterdir()) == []


def test_a_tally_counts():
    tally = Tally()
    tally.add(0, {"outcome": "result", "faults": [], "weak": [["names no file", "a:1", "b"]], "ms": 2.0, "bytes": 5})
    tally.add(1, {"outcome": "OSError", "faults": [["KeyError", "c:1", "d"]], "weak": [], "ms": 1.0, "bytes": 9})
    assert (tally.inputs, tally.slowest_ms, tally.slowest, tally.most_bytes) == (2, 2.0, 0, 9)
    assert found({"r": tally}) == ["r: 1 x KeyError at c:1: d", "weak, r: 1 x names no file at a:1: b"]
