import sqlite3

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.evaluation.trajectory import align_se2
from ebjax.io.trajectory import read_tum
from ebjax.slam.__main__ import Config, main

pytestmark = pytest.mark.usefixtures("unpainted")


def ate_rmse_m(estimate, truth):
    rows = np.abs(truth.timestamps[None] - estimate.timestamps[:, None]).argmin(1)
    a, b = estimate.poses[:, :3, 3], truth.poses[rows, :3, 3]
    matrix = align_se2(a, b)
    return float(np.sqrt(np.mean(np.sum((a @ matrix[:3, :3].T + matrix[:3, 3] - b)[:, :2] ** 2, 1))))


@pytest.mark.whole
def test_a_database_of_rtabmap_gets_its_closures_back(data, tmp_path, capsys):
    source = data("logs/rtabmap/corridor_v0.23.8_86_nodes.db")
    before = source.read_bytes()
    run(main, Config, [str(source), "--out", str(tmp_path / "run")])
    said = capsys.readouterr().out
    truth = read_tum(data("corridor_rgbd") / "groundtruth.txt")
    assert ate_rmse_m(read_tum(tmp_path / "run" / "trajectory.tum"), truth) < 0.003
    assert source.read_bytes() == before
    copy = tmp_path / "run" / "rtabmap.db"
    with sqlite3.connect(copy) as database:
        counts = dict(database.execute("SELECT type, COUNT(*) FROM Link GROUP BY type").fetchall())
    database.close()
    assert counts[0] == 170 and counts[4] >= 50 and counts[4] % 2 == 0
    assert f"{copy}: {counts[4] // 2} closures inserted, 0 already linked" in said
    assert f"rtabmap-reprocess -pub_loops {copy}" in said


def test_what_a_log_lacks_is_asked_for_in_one_line(tmp_path, capsys):
    folder = tmp_path / "walk"
    folder.mkdir()
    for k in range(3):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((48, 64, 3), 40 * k, np.uint8))
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        "image_width: 64\nimage_height: 48\ncamera_name: phone\ncamera_matrix: {rows: 3, cols: 3, "
        "data: [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1]}\ndistortion_model: plumb_bob\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    for flags, words in (
        ((), "walk: two things are missing: (1) the camera: give --camera FILE"),
        (("--camera", str(camera)), "camera.yaml: nothing says how the camera is mounted; measure and give --mount.h"),
        (("--camera", str(camera), "--mount.height-m", "-1", "--mount.pitch-deg", "20"), "mount.height_m is -1"),
    ):
        with pytest.raises(SystemExit) as stop:
            run(main, Config, [str(folder), "--out", str(tmp_path / "run"), *flags])
        error = capsys.readouterr().err
        assert stop.value.code == 2 and error.count("\n") == 1 and words in error
    assert not (tmp_path / "run").exists()
