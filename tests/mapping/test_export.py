import csv
import json
import shutil

import cv2
import numpy as np
import pytest
import yaml
from told_maps import AHEAD, MOUNT, add_session, looked_by_of, way

from ebjax.geometry.planar import between, compose
from ebjax.io.map_file.file import MapFile
from ebjax.io.trajectory import read_tum
from ebjax.mapping.contents import contents_lines, read_contents
from ebjax.mapping.export import export_map
from ebjax.mapping.sessions import facts_of
from ebjax.posegraph.g2o import read_g2o


@pytest.fixture
def log(tmp_path):
    """A folder with the images of a session."""
    folder = tmp_path / "monday" / "rgb"
    folder.mkdir(parents=True)
    for k in range(16):
        (folder / f"{k:03d}.png").write_bytes(b"never decoded")
    return folder.parent


@pytest.fixture
def made(tmp_path):
    with MapFile.create(tmp_path / "building.ebmap", {}) as kept:
        yield kept


def exported(kept, out):
    done = export_map(kept, out, 0.02)
    assert sorted(file.name for file in out.iterdir()) == list(done.files)
    return done


def test_a_map_gives_what_is_in_it(made, log, tmp_path):
    add_session(made, log, standing=True)
    out = tmp_path / "out"
    done = exported(made, out)
    assert done.notes == ()
    assert set(done.files) == {
        *("trajectory.tum", "pose_graph.g2o", "loop_closures.csv", "floor_map.png", "nav2_map.png", "nav2_map.yaml"),
        *("transforms.json", "pairs.txt", "report.html"),
    }
    track = read_tum(out / "trajectory.tum")
    assert len(track.timestamps) == 16
    np.testing.assert_allclose(track.timestamps[:3], [100.0, 100.5, 101.0])
    np.testing.assert_allclose(track.poses[::2, :2, 3], way(8)[:, :2], atol=1e-8)
    np.testing.assert_allclose(track.poses[1::2, :2, 3], compose(way(8), np.tile(AHEAD, (8, 1)))[:, :2], atol=1e-8)

    graph, ids = read_g2o(out / "pose_graph.g2o")
    assert ids.tolist() == list(range(8)) and len(graph.i) == 8
    poses = np.asarray(graph.poses)
    off = between(np.asarray(graph.measured), between(poses[graph.i], poses[graph.j]))
    np.testing.assert_allclose(np.sin(off), 0, atol=1e-9)

    with open(out / "loop_closures.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["i"], row["j"], row["kept"], row["reason"]) for row in rows] == [
        ("14", "0", "1", "kept"),
        ("14", "2", "0", "few matches"),
    ]
    assert float(rows[0]["theta_rad"]) == pytest.approx(-np.pi, abs=1e-6)

    said = json.loads((out / "transforms.json").read_text())
    assert [frame["file_path"] for frame in said["frames"]][:2] == ["../monday/rgb/000.png", "../monday/rgb/002.png"]
    np.testing.assert_allclose(np.array(said["frames"][0]["transform_matrix"])[:3, 3], MOUNT[:3, 3])
    assert (out / "pairs.txt").read_text().splitlines()[:2] == ["rgb/014.png rgb/000.png", "rgb/000.png rgb/002.png"]
    assert cv2.imread(str(out / "floor_map.png")) is not None
    where = yaml.safe_load((out / "nav2_map.yaml").read_text())
    grid = cv2.imread(str(out / "nav2_map.png"), cv2.IMREAD_GRAYSCALE)

    def cell(x, y):
        column, row = (np.array([x, y]) - where["origin"][:2]) // where["resolution"]
        return grid[grid.shape[0] - 1 - int(row), int(column)]

    assert cell(0.6, 0.1) == 254  # floor ahead of the first keyframe
    assert (grid == 0).any() and (grid == 205).any()


@pytest.mark.parametrize("standing", [True, False])
def test_without_depth_nothing_is_known_to_stand(made, log, tmp_path, standing):
    add_session(made, log, range_m=0.0, standing=standing)
    exported(made, tmp_path / "out")
    assert not (cv2.imread(str(tmp_path / "out" / "nav2_map.png"), cv2.IMREAD_GRAYSCALE) == 0).any()


@pytest.mark.parametrize("count", [6, 8])
def test_several_sessions_of_other_cameras_are_one_map(made, log, tmp_path, count):
    add_session(made, log, count)
    add_session(made, tmp_path / "tuesday", count, state=looked_by_of(0.1))
    done = exported(made, tmp_path / "out")
    assert {"trajectory_1.tum", "trajectory_2.tum"} <= set(done.files) and "trajectory.tum" not in done.files
    assert len(read_tum(tmp_path / "out" / "trajectory_2.tum").timestamps) == 2 * count
    graph, ids = read_g2o(tmp_path / "out" / "pose_graph.g2o")
    assert len(ids) == 2 * count and len(graph.i) == 2 * count
    pairs = (tmp_path / "out" / "pairs.txt").read_text().splitlines()
    assert pairs[0].startswith("monday/rgb/") and pairs[1].startswith("tuesday/rgb/")
    assert len(pairs) == 2 * count  # those of two sessions do not follow on each other
    assert any("pairs.txt: names are of images in" in note for note in done.notes)
    missing = [note for note in done.notes if "transforms.json" in note]
    assert len(missing) == 1 and str(tmp_path / "tuesday" / "rgb" / "000.png") in missing[0]


def test_cameras_of_several_sessions_are_put_on_one(made, log, tmp_path):
    add_session(made, log)
    add_session(made, shutil.copytree(log, tmp_path / "tuesday"), state=looked_by_of(0.1))
    exported(made, tmp_path / "out")
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    first, other = (np.array(frames[k]["transform_matrix"]) for k in (0, 8))
    np.testing.assert_allclose(other - first, 0.1 * np.eye(4)[0][:, None] * np.eye(4)[3], atol=1e-12)


def test_a_log_that_was_driven_twice_has_each_image_once(made, log, tmp_path):
    add_session(made, log)
    add_session(made, log)
    done = exported(made, tmp_path / "out")
    assert done.notes == () and {"trajectory_1.tum", "trajectory_2.tum"} <= set(done.files)
    assert len(json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]) == 8
    assert len((tmp_path / "out" / "pairs.txt").read_text().splitlines()) == 8


def test_what_cannot_be_written_is_said(made, tmp_path):
    add_session(made, "a robot", names="image {}")
    done = exported(made, tmp_path / "out")
    assert "transforms.json" not in done.files and "pairs.txt" not in done.files
    assert len(done.notes) == 2 and all(note.startswith("not written: ") for note in done.notes)
    assert str(tmp_path / "out" / "pairs.txt") in done.notes[1] and "blanks" in done.notes[1]


def test_a_map_without_views_has_no_picture(made, log, tmp_path):
    add_session(made, log, view=False)
    done = exported(made, tmp_path / "out")
    assert "floor_map.png" not in done.files and "nav2_map.png" in done.files
    assert "8 keyframes without a floor view (--no-views)" in done.notes[0]


def test_attempts_of_a_run_are_not_exported_beside_it(made, log, tmp_path):
    first, again = (facts_of(str(log), 100.0, {}, again=again) for again in (False, True))
    add_session(made, log, finish=False, facts=first)
    add_session(made, log, 4, finish=False, facts=again)
    assert [one.id for one in read_contents(made).sessions] == [1]
    lines = contents_lines(made.path, read_contents(made))
    assert "1 session, 8 keyframes" in lines[0] and "2 candidates not decided yet" in lines[0]
    assert "not finished: run the same log with the same --map to go on" in lines[1]
    made.end_session(2)
    contents = read_contents(made)
    assert [one.id for one in contents.sessions] == [2]
    assert len(contents.keyframes) == 4 and set(contents.edges.i) <= set(contents.keyframes.id)
    exported(made, tmp_path / "out")


def test_a_map_is_exported_while_it_is_written(made, log, tmp_path):
    add_session(made, log, finish=False)
    with MapFile.open(made.path, write=False) as reader:
        exported(reader, tmp_path / "out")
        add_session(made, log, finish=False)
        exported(reader, tmp_path / "later")
    assert len(read_tum(tmp_path / "later" / "trajectory_2.tum").timestamps) == 16


def test_an_empty_map_is_refused(made, tmp_path):
    with pytest.raises(ValueError, match="holds no keyframe yet"):
        export_map(made, tmp_path / "out", 0.02)
    assert not (tmp_path / "out").exists()
