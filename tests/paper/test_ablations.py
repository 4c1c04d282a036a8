import json

import cv2
import pytest

from ebjax.paper import ablation_table, ablations
from ebjax.paper.ablations import FIGURES, QUICK, Scale, base_world
from ebjax.paper.page import number


def test_one_setting_changes():
    base = base_world(QUICK, 0)
    shifted = base_world(QUICK, 0, shift_m=0.8)
    assert shifted.robot.lateral_offset_m == 0.8 and shifted.floor == base.floor
    assert base_world(QUICK, 0, family="wood").robot == base.robot
    assert base_world(QUICK, 0, way_m=4.0).robot.distance_m == 4.0 < base.robot.distance_m
    assert base_world(Scale(), 0).robot.step_m < base.robot.step_m


def test_a_table_and_a_figure_each(tmp_path, monkeypatch):
    point = {"recall_at_1_1m": 0.9, "ate_rmse_m": 0.02, "share_of_odometry": None}
    for name in FIGURES:
        monkeypatch.setattr(ablations.Ablations, name, lambda self: {"": {"1": point, "2": point}})
    lines = ablation_table.make(tmp_path, quick=True, seed=0)
    assert lines.count("| 1 | 0.9 | 0.02 | – |") == len(FIGURES)
    found = json.loads((tmp_path / "ablations.json").read_text())
    assert found.keys() == {*FIGURES, "settings"} and found["kernel"][""]["2"] == point
    for name in FIGURES:
        assert cv2.imread(str(tmp_path / f"ablation_{name}.png")) is not None
        assert f"(ablation_{name}.png)" in (tmp_path / "ablations.md").read_text()


@pytest.mark.parametrize(("value", "text"), [(None, "–"), (0.123456, "0.1235"), (3, "3")])
def test_numbers(value, text):
    assert number(value) == text
