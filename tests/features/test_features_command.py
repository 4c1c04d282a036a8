import csv
import functools
import json

import cv2
import numpy as np
import pytest

from ebjax.features.__main__ import TurnConfig, turn

QUADS = {
    "ceramic": [180, 299, 460, 290, 585, 443, 66, 462],
    "marble": [544, 649, 1379, 646, 1602, 1049, 300, 1045],
    "stone": [544, 649, 1379, 646, 1602, 1049, 300, 1045],
}


@pytest.fixture
def command(program):
    return functools.partial(program, "ebjax.features")


def transform(h, points):
    p = np.c_[points, np.ones(len(points))] @ np.asarray(h).T
    return p[:, :2] / p[:, 2:]


def by_input(result, extractor="floornet"):
    return {record["input"]: record for record in result["results"] if record["extractor"] == extractor}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ceramic", "marble", "stone"])
def test_real_opposing_pairs_match_on_the_turned_floor_only(command, data, tmp_path, name):
    folder = data("opposing_pairs") / name
    images = [next(folder.glob(f"{side}.[pj]*g")) for side in "ab"]
    done = command(*images, "--quad", *QUADS[name], "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "raw           floor      floor + pi" in done.stdout
    records = by_input(json.loads((tmp_path / "out" / "transform.json").read_text()))
    truth = json.loads((folder / "gt.json").read_text())
    a, b = np.array(truth["points_topA"]), np.array(truth["points_rot180_topB"])
    turned = records["floor + pi"]
    assert turned["believed"] and turned["inliers"] > 80
    assert np.linalg.norm(transform(turned["floor_b_from_a"], a) - b, axis=1).mean() < 3
    # The same in raw pixels, by way of the quad.
    square = np.array([[0, 0], [400, 0], [400, 400], [0, 400]], np.float32)
    top = cv2.getPerspectiveTransform(np.array(QUADS[name], np.float32).reshape(4, 2), square).astype(np.float64)
    in_b = transform(turned["image_b_from_a"], transform(np.linalg.inv(top), a))
    assert np.linalg.norm(400 - transform(top, in_b) - b, axis=1).mean() < 3
    for other in ("raw", "floor"):
        assert not records[other]["believed"]
        assert records[other]["inliers"] < turned["inliers"] / 4


@pytest.fixture(scope="module")
def written(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    made = scene()
    made.write(folder)
    return folder, made


@pytest.mark.slow
def test_metric_floor_and_depth_measure_the_motion_to_millimetres(command, written, a_from_b):
    folder, made = written
    done = command(
        *("a.png", "b.png", "--camera", "camera.json", "--depth-a", "depth_a.png", "--depth-b", "depth_b.png"),
        *("--out", "metric"),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads((folder / "metric" / "transform.json").read_text())
    records = by_input(result)
    assert [records[k]["believed"] for k in ("raw", "floor", "floor + pi")] == [False, False, True]
    assert result["results"][result["best"]] == records["floor + pi"]
    for key in ("a_from_b", "a_from_b_depth"):
        found = records["floor + pi"][key]
        error = np.array([found["x_m"], found["y_m"], found["theta_rad"]]) - a_from_b
        error[2] = np.mod(error[2] + np.pi, 2 * np.pi) - np.pi
        assert np.abs(error[:2]).max() < 0.003 and abs(error[2]) < np.radians(0.15)
        covariance = np.array(found["covariance"])
        assert np.linalg.eigvalsh(covariance).min() > 0 and np.sqrt(covariance[0, 0]) < 0.02
    corners = np.array([[100.0, 200], [380, 200], [380, 330], [100, 330]])
    near = transform(made.image_b_from_a, corners)
    assert np.linalg.norm(transform(records["floor + pi"]["image_b_from_a"], corners) - near, axis=1).max() < 2

    rows = list(csv.DictReader((folder / "metric" / "matches.csv").read_text().splitlines()))
    a, b = (np.array([[float(row[f"{c}_{k}"]) for c in "xy"] for row in rows]) for k in "ab")
    inliers = np.array([row["inlier"] == "1" for row in rows])
    assert inliers.sum() == records["floor + pi"]["guided_inliers"]
    assert np.median(np.linalg.norm(transform(made.image_b_from_a, a[inliers]) - b[inliers], axis=1)) < 1.5
    assert cv2.imread(str(folder / "metric" / "matches.png")) is not None


@pytest.mark.slow
def test_quad_with_a_camera_is_metric_too(command, written, a_from_b):
    folder, _ = written
    quad = (140, 120, 340, 120, 430, 300, 50, 300)
    done = command("a.png", "b.png", "--camera", "camera.json", "--quad", *quad, "--out", "both", cwd=folder)
    assert done.returncode == 0, done.stderr
    found = by_input(json.loads((folder / "both" / "transform.json").read_text()))["floor + pi"]["a_from_b"]
    np.testing.assert_allclose([found["x_m"], found["y_m"]], a_from_b[:2], atol=0.005)


def test_raw_images_alone_say_that_there_is_no_floor(command, written):
    folder, _ = written
    done = command("a.png", "b.png", "--out", "raw", cwd=folder)
    assert done.returncode == 0 and "floor views need --camera or --quad" in done.stdout
    assert "no common floor found" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.png", "absent.png"], "absent.png: no such file"),
        (["a.png", "cut.png"], "cut.png: truncated or damaged PNG; copy it again"),
        (["a.png", "small.png"], "small.png: 100x80 pixels, but a.png has 480x360"),
        (["a.png", "small.png", "--camera", "camera.json"], "small.png: 100x80 pixels, but a.png has 480x360"),
        (["a.png", "b.png", "--quad", 10, 10, 500, 10, 400, 300, 10, 300], "quad: (500, 10) lies outside"),
        (["a.png", "b.png", "--quad", 10, 10, 100, 10, 200, 10, 10, 300], "quad: three of the points"),
        (["a.png", "b.png", "--quad", 10, 10, 10, 300, 400, 300, 400, 10], "quad: not a convex patch in order"),
        (["a.png", "b.png", "--size", "5"], "--size is 5; give 50 to 2000 px"),
        (["a.png", "b.png", "--depth-a", "depth_a.png"], "--depth-a and --depth-b go together"),
        (["a.png", "b.png", "--model", "rigid"], "--model rigid needs --camera"),
        (["a.png", "b.png", "--camera", "bad.json"], "bad.json: not recognised as a camera's calibration"),
        (
            ["a.png", "b.png", "--camera", "camera.json", "--depth-a", "none.png", "--depth-b", "depth_b.png"],
            "none.png: no pixel has depth",
        ),
    ],
)
def test_bad_input_is_one_line_exit_2_and_no_output(command, written, tmp_path, arguments, message):
    folder, made = written
    made.write(tmp_path)
    (tmp_path / "cut.png").write_bytes((folder / "b.png").read_bytes()[:20000])
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((80, 100, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "none.png"), np.zeros((360, 480), np.uint16))
    (tmp_path / "bad.json").write_text("{}")
    done = command(*arguments, "--out", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {message}") and len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_all_leaves_out_what_cannot_be_used_and_says_why(command, written, monkeypatch, tmp_path):
    folder, _ = written
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    done = command("a.png", "b.png", "--extractor", "all", "--out", tmp_path / "all", cwd=folder)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines[1:6]] == ["floornet", "rootsift", "sift", "orb", "surf"]
    left_out = [line for line in lines if line.startswith("left out: ")]
    # The others' weights come with packages that may be installed.
    without = [line.split()[2] for line in left_out]
    assert [name for name in without if name not in ("aliked", "xfeat")] == ["superpoint", "d2net", "alike"]
    assert all("python -m ebjax.models convert" in line for line in left_out)


def test_a_network_without_weights_is_refused(command, written, monkeypatch, tmp_path):
    folder, _ = written
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    done = command("a.png", "b.png", "--extractor", "d2net", "--out", tmp_path / "out", cwd=folder)
    assert done.returncode == 2 and not (tmp_path / "out").exists()
    assert done.stderr.startswith("error: d2net needs weights") and len(done.stderr.splitlines()) == 1


def test_turn_draws(written, tmp_path, capsys):
    folder, _ = written
    image = cv2.imread(str(folder / "a.png"))[100:165, 100:200]
    cv2.imwrite(str(tmp_path / "small.png"), image)
    turn(TurnConfig(tmp_path / "small.png", tmp_path / "turn.png"))
    assert "exact offset" in capsys.readouterr().out and cv2.imread(str(tmp_path / "turn.png")) is not None
