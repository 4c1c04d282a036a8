import dataclasses
import json

import numpy as np
import pytest

from ebjax.features.__main__ import TableConfig, table
from ebjax.features.table import Cell, Pair, markdown, motion_error_px
from ebjax.models.convert import convert_checkpoint
from ebjax.models.weights import save_weights

QUAD = np.array([[140.0, 120.0], [340.0, 120.0], [430.0, 300.0], [50.0, 300.0]])


@pytest.fixture(scope="module")
def pair(scene):
    made = scene()
    return Pair("made", *made.images, QUAD, made.image_b_from_a)


def write(folder, made):
    folder.mkdir()
    made.write(folder)
    (folder / "gt.json").write_text(json.dumps({"quad": QUAD.tolist(), "H_a_to_b": made.image_b_from_a.tolist()}))


def test_error_is_that_on_the_common_floor(pair):
    assert motion_error_px(pair, 3 * pair.b_from_a) < 1e-9
    # The quad's width of 400 px is 200 px on its upper edge in the image, and 380 px on its lower one.
    shifted = np.array([[1.0, 0, 2.0], [0, 1, 0], [0, 0, 1]]) @ pair.b_from_a
    assert 2 * 400 / 380 < motion_error_px(pair, shifted) < 2 * 400 / 200
    assert motion_error_px(pair, np.eye(3)) > 100
    apart = Pair("apart", pair.image_a, pair.image_b, QUAD, np.array([[1.0, 0, 1e4], [0, 1, 0], [0, 0, 1]]))
    with pytest.raises(ValueError, match=r"apart: .* no floor in common"):
        motion_error_px(apart, np.eye(3))


def test_table_of_means_and_of_pairs():
    cells = {"one": Cell(3, 10, False, np.inf), "two": Cell(30, 40, True, 1.234)}
    dear = {"one": Cell(3, 10, False, 0.5, 3.0, 90, 12.0), "two": Cell(30, 40, True, 1.25, 1.2, 110, 13.0)}
    lines = list(markdown({"orb": {"raw": cells, "floor": cells, "floor + pi": dear}}, {"orb": 1.25}))
    assert lines[4] == "| orb | 16 / 25, 1 of 2 | 16 / 25, 1 of 2 | 16 / 25, 1 of 2 |"
    assert lines[10] == "| orb | 100 | 16 | 0.53 | 0.88 | 1 of 2 | 12 | 1.2 |"
    assert lines[-5] == "| extractor | input | one (right below 3.0 px) | two (right below 3.0 px) |"
    assert lines[-3] == "| orb | raw | 3 / 10, - | 30 / 40 *, 1.2 px |"
    assert [len({line.count("|") for line in part}) for part in (lines[2:5], lines[8:11], lines[14:])] == [1, 1, 1]


@pytest.mark.slow
def test_command_writes_the_table_and_says_what_is_left_out(scene, tmp_path, capsys):
    (tmp_path / "pairs").mkdir()
    write(tmp_path / "pairs" / "one", scene())
    table(TableConfig(tmp_path / "pairs", tmp_path / "out", ("rootsift", "d2net"), tmp_path))
    printed = capsys.readouterr().out
    assert "Left out: d2net needs weights" in printed and "python -m ebjax.models convert" in printed
    assert (tmp_path / "out" / "table.md").read_text() in printed
    values = json.loads((tmp_path / "out" / "table.json").read_text())
    assert values["table"].keys() == {"rootsift"} and values["left_out"].keys() == {"d2net"}
    row = {name: cells["one"] for name, cells in values["table"]["rootsift"].items()}
    assert [row[name]["right"] for name in ("raw", "floor", "floor + pi")] == [False, False, True]
    assert row["floor + pi"]["error_px"] < 1.5 and row["floor + pi"]["believed"]
    assert row["floor + pi"]["keypoints"] > 100 and row["floor + pi"]["view_ms"] > 0
    assert row["raw"]["view_ms"] is None and row["raw"]["right_px"] == 3.0


def test_a_truth_that_says_how_good_it_is_is_believed(pair):
    known = dataclasses.replace(pair, truth_px=0.4)
    assert pair.right_px == 3.0 and known.right_px == pytest.approx(0.8)
    assert Cell(9, 10, True, 0.9, pair.right_px).right and not Cell(9, 10, True, 0.9, known.right_px).right


def test_bad_pairs_are_named(scene, tmp_path):
    (tmp_path / "pairs").mkdir()
    write(tmp_path / "pairs" / "one", scene())
    with pytest.raises(ValueError, match="extractor 'sit' is unknown"):
        table(TableConfig(tmp_path / "pairs", tmp_path / "out", ("sit",)))
    truth = tmp_path / "pairs" / "one" / "gt.json"
    truth.write_text(json.dumps({"quad": (QUAD + 100).tolist(), "H_a_to_b": np.eye(3).tolist()}))
    with pytest.raises(ValueError, match=r"one: quad: .* lies outside the 480x360 image"):
        table(TableConfig(tmp_path / "pairs", tmp_path / "out", ("rootsift",)))
    with pytest.raises(ValueError, match="alike needs weights"):
        table(TableConfig(tmp_path / "pairs", tmp_path / "out", ("alike",), tmp_path))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_alike_is_right_on_every_real_pair_on_the_turned_floor_only(data, tmp_path):
    kind, arrays, _ = convert_checkpoint(data("reference") / "alike-n.pth")
    save_weights(tmp_path / "alike.safetensors", kind, arrays)
    table(TableConfig(data("opposing_pairs"), tmp_path / "out", ("alike",), tmp_path))
    row = json.loads((tmp_path / "out" / "table.json").read_text())["table"]["alike"]
    assert len(row["raw"]) == 3
    assert all(cell["right"] and cell["believed"] and cell["inliers"] > 100 for cell in row["floor + pi"].values())
    assert not any(cell["right"] for name in ("raw", "floor") for cell in row[name].values())
