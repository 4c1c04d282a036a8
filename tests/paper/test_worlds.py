import dataclasses

import pytest

from ebjax.paper.run import read_run
from ebjax.paper.worlds import QUICK_STEP_M, QUICK_WAY_M, default_folder, read_world, render


def test_a_world_is_rendered_once_and_when_it_changes(drawn, small_worlds, tmp_path):
    config, before = read_world(small_worlds, "W", quick=False), len(drawn)
    for _ in range(2):
        path = render(config, "W", tmp_path)
    assert len(drawn) == before + 1
    (tmp_path / "W.txt").unlink()  # as a killed process leaves it
    (tmp_path / ".W.12345678.partial").mkdir()
    render(config, "W", tmp_path)
    render(dataclasses.replace(config, seed=4), "W", tmp_path)
    assert len(drawn) == before + 3
    assert sorted(file.name for file in tmp_path.iterdir()) == ["W", "W.txt"]
    run = read_run(path)
    assert run.out.max() < run.back.min() and len(run.out) > 10 < len(run.back)


def test_quick_worlds_are_cut_short():
    full, quick = (read_world(default_folder(), "D4", quick=quick) for quick in (False, True))
    assert full.robot.distance_m > quick.robot.distance_m == QUICK_WAY_M
    assert full.robot.step_m < quick.robot.step_m == QUICK_STEP_M
    assert quick == dataclasses.replace(full, robot=quick.robot)


def test_a_world_that_is_not_there(tmp_path):
    with pytest.raises(ValueError, match=r"D9.yaml: no such file; --worlds"):
        read_world(tmp_path, "D9", quick=True)
