"""The whole command on one small world: measured, found again, damaged, and refused."""

import json
import shutil

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.features.extractor import extractor
from ebjax.geometry.camera import image_from_floor
from ebjax.geometry.homography import apply
from ebjax.paper import experiment
from ebjax.paper.__main__ import TablesConfig, main, tables
from ebjax.paper.pairs import cut_pairs, facing_frames
from ebjax.paper.run import read_run


def command(out, folder, *flags):
    run(tables, TablesConfig, ["--quick", "--out", str(out), "--worlds", str(folder), "--weights", str(folder), *flags])


def restrict(patch):
    """Fewer rows: what each costs is compiled for it."""
    for name, kept in (("DESCRIPTORS", ("floornet", "joint", "netvlad")), ("EXTRACTORS", ("orb", "d2net"))):
        patch.setattr(experiment, name, kept)
    patch.setattr(experiment, "extractor", lambda name, weights=None: extractor("orb"))


@pytest.fixture(scope="session")
def done(drawn, small_worlds, tmp_path_factory):
    """The command's results."""
    out = tmp_path_factory.mktemp("paper") / "out"
    patch = pytest.MonkeyPatch()
    patch.delenv("EBJAX_DATA", raising=False)
    restrict(patch)
    command(out, small_worlds, "--sets", "W", "--plans", "W")
    patch.undo()
    return out


@pytest.mark.slow
def test_tables_and_pictures(done):
    tables = json.loads((done / "tables.json").read_text())
    cell = tables["table 1"]["floornet, correlation: floor + pi"]["W"]
    blind = tables["table 1"]["floornet, correlation: raw"]["W"]
    assert cell["one_way_recall"] > max(0.7, blind["one_way_recall"])
    assert cell["one_way_recall_radius_m"] == pytest.approx(5 / 15, abs=0.02)
    assert cell["paper_recall_radius_m"] == pytest.approx(2 * cell["one_way_recall_radius_m"], abs=0.01)
    assert cell["paper_recall_queries"] >= cell["one_way_recall_queries"] > 0
    recall, precision = (np.array(cell["curve"][key]) for key in ("recall", "precision"))
    assert (np.diff(recall) >= 0).all() and recall[-1] == pytest.approx(cell["recall_at_1_1m"]) and precision[0] == 1
    assert {row["W"]["pairs"] for row in tables["table 3"].values()} == {1}
    assert tables["table 3"]["orb: floor + pi"]["W"]["right"] == 1
    drift = {row: cells["W"] for row, cells in tables["table 4"].items()}
    assert drift["loop closures off"]["ate_rmse_m"] == pytest.approx(drift["odometry"]["ate_rmse_m"])
    assert drift["ours"]["share_of_odometry"] < 0.3 and drift["ours"]["false_closures"] == 0 < drift["ours"]["closures"]
    text = (done / "paper.md").read_text()
    assert "| joint, correlation: floor and whole, both ways |" in text
    assert "No real pairs" in text and "netvlad needs weights" in text
    assert "netvlad" not in "".join(tables["table 1"]) and "netvlad" in tables["left_out"]
    for line in text.splitlines():
        if line.startswith("!["):
            assert cv2.imread(str(done / line.split("(")[-1].rstrip(")"))) is not None


@pytest.mark.slow
def test_a_second_run_measures_what_is_damaged_alone(done, small_worlds, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("EBJAX_DATA", raising=False)
    restrict(monkeypatch)
    out = shutil.copytree(done, tmp_path / "out")
    command(out, small_worlds, "--sets", "W", "--plans", "W")
    assert " 0 cells measured" in f" {capsys.readouterr().out}".replace("\n", " ")
    cell = out / "cells" / "recall_W_joint_floor.json"
    cell.write_text(cell.read_text()[:-20])
    command(out, small_worlds, "--sets", "W", "--plans", "W")
    printed = capsys.readouterr().out
    assert f"{cell}: damaged; measured again" in printed and "1 cells measured" in printed
    assert json.loads((out / "tables.json").read_text()) == json.loads((done / "tables.json").read_text())


def test_pairs_show_the_same_floor(small_run):
    found = read_run(small_run)
    assert set(found.out).isdisjoint(found.back) and found.out.max() < found.back.min()
    made = cut_pairs(found, "W", 2)
    for pair in made:
        assert (pair.quad >= 0).all() and (pair.quad <= [found.camera.width - 1, found.camera.height - 1]).all()
    centre = np.asarray(apply(np.linalg.inv(np.asarray(image_from_floor(found.camera))), made[0].quad)).mean(0)
    a, b = (int(frame) for frame in facing_frames(found, centre, 2)[0])
    image = np.asarray(image_from_floor(found.camera))
    world = np.array([[found.truth[a, 0] + 2.0, 0.1]])

    def seen(frame):
        x, y, heading = found.truth[frame]
        c, s = np.cos(heading), np.sin(heading)
        return np.asarray(apply(image, (world - [[x, y]]) @ np.array([[c, -s], [s, c]])))

    np.testing.assert_allclose(np.asarray(apply(made[0].b_from_a, seen(a))), seen(b), atol=1e-6)


@pytest.mark.parametrize(
    ("text", "word"),
    [(None, "no such file"), ("robot: {step_m: -1}\n", "X.yaml: robot.step_m"), ("robots: {}\n", "robots")],
)
def test_bad_worlds_are_named(tmp_path, capsys, text, word):
    if text is not None:
        (tmp_path / "X.yaml").write_text(text)
    with pytest.raises(SystemExit) as stop:
        run(tables, TablesConfig, ["--out", str(tmp_path / "out"), "--worlds", str(tmp_path), "--sets", "X", "--plans"])
    assert stop.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("error: ") and word in line


def test_commands_by_name(tmp_path, capsys):
    main(["--help"])
    listed = capsys.readouterr().out
    for name in ("tables", "crops", "stress", "ablations"):
        assert f"python -m ebjax.paper {name} " in listed
    absent = ["tables", "--worlds", str(tmp_path), "--sets", "X"]
    for argv, word in ((["paper"], "no command 'paper'; there are tables, crops"), (absent, "X.yaml: no such file")):
        with pytest.raises(SystemExit) as stop:
            main(argv)
        assert stop.value.code == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert line.startswith("error: ") and word in line
