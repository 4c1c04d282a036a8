"""The command on one small run: clean views are found, corruption costs, no corruption changes nothing."""

import json
import shutil

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.paper.__main__ import StressConfig
from ebjax.paper.__main__ import stress as command
from ebjax.paper.retrieval import Retrieval, merits
from ebjax.paper.run import read_run
from ebjax.paper.stress import floor_views, measure
from ebjax.places.descriptor import descriptor
from ebjax.places.recall import facing_pairs


@pytest.mark.slow
def test_command(small_run, tmp_path, capsys):
    run(command, StressConfig, [str(small_run), "--out", str(tmp_path), "--seeds", "2", "--strength", "2"])
    assert "blotches (" in capsys.readouterr().out
    found = json.loads((tmp_path / "stress.json").read_text())
    for method in ("rootsift-vlad, correlation", "rootsift-vlad, cosine"):
        cells = found["runs"]["blotches"][method]
        assert cells.keys() == {"clean", "0", "1"} and cells["clean"].keys() == {"facing", "both ways"}
        means = found["mean"][method]
        assert means["facing clean recall_at_1_1m"] >= 0.8 > means["facing corrupted recall_at_1_1m"]
        assert means["both ways clean recall_at_1_1m"] <= means["facing clean recall_at_1_1m"]
    assert found["settings"]["corruption"]["rotation_deg"] == 6
    assert "**rootsift-vlad, cosine**" in (tmp_path / "stress.md").read_text()
    assert cv2.imread(str(tmp_path / "stress.png")) is not None


@pytest.mark.slow
def test_what_is_measured_is_what_the_tables_of_the_paper_measure(small_run):
    one, chosen = read_run(small_run), descriptor("hog")
    found = measure(one, floor_views(one), {"hog": chosen}, 0.0, 1)["hog, cosine"]
    assert found["clean"] == found["0"]
    expected = Retrieval(one, chosen).measure("floor + pi", ("cosine",))["cosine"]
    for key, value in found["clean"]["facing"].items():
        assert value == expected[key], key


def test_a_claim_of_the_wrong_direction_is_wrong(small_run):
    one = read_run(small_run)
    count, asked = len(one.out), len(one.back)
    first = facing_pairs(one.truth[one.frames], one.view.centre_m, 1.0)[count:, :count].argmax(1)
    score = np.linspace(1, 0, asked)
    right = merits(one, first, score, np.ones(asked, bool))
    assert right == merits(one, first, score) and right["recall_at_1_1m"] == 1
    wrong = merits(one, first, score, np.zeros(asked, bool))
    assert wrong["recall_at_1_1m"] == 0


def test_bad_input(small_run, tmp_path, capsys):
    twin = tmp_path / "blotches"
    shutil.copytree(small_run, twin)
    shutil.copytree(small_run, tmp_path / "untrue")
    (tmp_path / "untrue" / "groundtruth.txt").unlink()
    for flags, words in (
        ([str(small_run), str(twin)], "same name"),
        ([str(small_run), "--descriptors", "joint"], "joint"),
        ([str(small_run), "--descriptors", "none"], "unknown"),
        ([str(small_run), "--seeds", "0"], "--seeds"),
        ([str(tmp_path / "untrue")], "groundtruth.txt"),
    ):
        with pytest.raises(SystemExit) as stop:
            run(command, StressConfig, [*flags, "--out", str(tmp_path / "out")])
        assert stop.value.code == 2 and words in capsys.readouterr().err
