"""A run localised in a map's file: what is written, and that the map stays as it is."""

import csv
import json

import numpy as np
import pytest
import small_run

from ebjax.geometry.planar import between
from ebjax.io.trajectory import read_tum
from ebjax.mapping.localised_run import localise_run
from ebjax.slam.world import planar

pytestmark = pytest.mark.slow


def found(path, out, recording, **options):
    camera = options.pop("camera", small_run.camera())
    return localise_run(
        path, recording, camera, small_run.default_view(camera), small_run.CONFIG, out, **options
    )  # fmt: skip


def test_the_same_run_is_found_where_it_was(whole, tmp_path):
    before = whole.path.read_bytes()
    recording = small_run.recording()
    lines = found(whole.path, tmp_path / "out", recording)
    assert whole.path.read_bytes() == before
    assert not list(whole.path.parent.glob("*-wal"))
    said = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert said["frames"] == len(recording) and said["found"] > 0.8 * said["frames"]
    assert any(line.startswith(f"found at frame {said['first_found']};") for line in lines)
    track = read_tum(tmp_path / "out" / "trajectory.tum")
    assert len(track.timestamps) == said["found"]
    rows = np.searchsorted(recording.timestamps, track.timestamps - 1e-6)
    off = between(planar(track.poses), whole.run.poses[rows])
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.05 and np.degrees(np.abs(off[:, 2])).max() < 1
    assert {file.name for file in (tmp_path / "out").iterdir()} == {"metrics.json", "trajectory.tum", "whereabouts.csv"}
    with open(tmp_path / "out" / "whereabouts.csv", newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["name"] for row in table] == list(recording.names)
    assert {row["state"] for row in table} <= {"lost", "found"}
    assert all((row["x_m"] == "") == (row["state"] == "lost") for row in table)


def test_a_start_is_given_in_degrees(whole, tmp_path):
    x, y, heading = whole.run.poses[0]
    start = float(x), float(y), float(np.degrees(heading))
    found(whole.path, tmp_path / "out", small_run.recording(4), start=start)
    said = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (said["first_found"], said["found"]) == (0, 4)


def test_another_camera_is_refused_by_name(whole, tmp_path):
    with pytest.raises(ValueError, match="camera"):
        found(whole.path, tmp_path / "out", small_run.recording(4), camera=small_run.camera(20.0))
    assert not (tmp_path / "out").exists()
