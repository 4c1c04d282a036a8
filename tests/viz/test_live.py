import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ebjax.slam.frame import Closure, Update
from ebjax.viz import live
from ebjax.viz.live import Live
from ebjax.viz.live_scene import OPPOSING, REFUSED, SAME, floor_mesh

FLOOR_FROM_VIEW = np.array([[0.0, -0.02, 1.59], [-0.02, 0.0, 0.49], [0.0, 0.0, 1.0]])


def update(stamp_s, frame, keyframe, pose, **more):
    return Update(frame, stamp_s, keyframe, pose, None, np.eye(3), **{"milliseconds": 30.0, **more})


def closure(i, j, *, opposing=True, kept=True, reason="kept"):
    return Closure(i, j, opposing, np.zeros(3), kept, reason)


def view(shade=120):
    image = np.full((50, 50, 3), shade, np.uint8)
    image[-10:, :15] = 0
    return image


def updates(start_s=0.0):
    """Ten keyframes out and back with frames between, a closure that is taken back, and a path that moves them all."""
    truth = np.array([[0.5 * min(k, 9 - k), 0.1 * (k > 4), np.pi * (k > 4)] for k in range(10)])
    drifted = truth + np.linspace(0, 0.3, 10)[:, None] * [0, 1, 0]
    for k in range(10):
        yield update(start_s + k, 2 * k, k, drifted[k], view=view(), milliseconds=20.0 + k)
        facing = closure(2 * k, 2 * (9 - k))
        refused = closure(2 * k, 2 * k - 8, opposing=False, kept=False, reason="few matches")
        yield update(start_s + k + 0.5, 2 * k + 1, None, drifted[k], closures=(facing, refused) if k in (6, 7) else ())
    back = closure(12, 6, kept=False, reason="contradicts the path")
    yield update(start_s + 10, 20, None, truth[9], path=truth, closures=(back,))


def rows_of(path):
    """What rerun reads of a recording: by entity, its rows as mappings."""
    chunk = pytest.importorskip("rerun.chunk", reason="needs a rerun-sdk that reads recordings back as chunks")
    found: dict[str, list[dict]] = {}
    for part in chunk.RrdReader(path).stream():
        found.setdefault(part.entity_path, []).extend(part.to_record_batch().to_pylist())
    return found


def record(folder, sequence):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    shown = Live(save=folder / "new" / "run.rrd")
    for each in sequence:
        shown.show(each, FLOOR_FROM_VIEW)
    assert shown.close() == ()
    return rows_of(folder / "new" / "run.rrd")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return record(tmp_path_factory.mktemp("live"), updates())


def rgb(packed):
    return tuple(packed >> shift & 255 for shift in (24, 16, 8))


def test_a_recording_holds_the_run(found):
    strips = [row["LineStrips3D:strips"] for row in found["/map/path"] if row.get("LineStrips3D:strips")]
    (last,) = strips[-1]
    assert len(last) == 10 and last[9][:2] == pytest.approx([0.0, 0.1])
    shown = [row["Scalars:scalars"] for row in found["/milliseconds"] if row.get("Scalars:scalars")]
    assert len(shown) == 21 and shown[4] == [22.0]
    assert [row["frame"] for row in found["/map/robot"] if row.get("frame") is not None] == list(range(21))
    said = [row["TextLog:text"][0] for row in found["/log"]]
    assert said[0] == "12 - 6, opposing: kept" and said[-1] == "12 - 6, opposing: contradicts the path"
    assert "/view" in found


def test_closures_are_coloured_by_what_they_are(found):
    before = [row for row in found["/map/closures/newest"] if row.get("LineStrips3D:strips")]
    colours = [rgb(colour) for colour in before[-1]["LineStrips3D:colors"]]
    assert colours == [OPPOSING, REFUSED, OPPOSING, REFUSED]
    # The path settles them: one was taken back, one stands, at the corrected poses.
    kept = found["/map/closures/opposing"][-1]
    (segment,) = kept["LineStrips3D:strips"]
    assert [end[:2] for end in segment] == [pytest.approx([1.0, 0.1]), pytest.approx([1.0, 0.0])]
    assert len({OPPOSING, SAME, REFUSED}) == 3


def test_floor_views_are_laid_apart_and_follow_the_path(found):
    laid = sorted((name for name in found if name.startswith("/map/floor/")), key=lambda name: int(name[11:]))
    assert 4 <= len(laid) <= 10
    poses = [row["Transform3D:translation"][0][:2] for row in found[laid[-1]] if row.get("Transform3D:translation")]
    assert len(poses) == 2 and poses[0][1] > poses[1][1] == pytest.approx(0.1)
    assert len([row for row in found[laid[0]] if row.get("Transform3D:translation")]) == 1  # it did not move


def test_stamps_are_dates_where_they_are_such(found, tmp_path):
    def stamp(rows):
        return next(row["stamp"] for row in rows["/map/robot"] if row.get("stamp") is not None)

    first, *_ = updates(1.7e9)
    dated = record(tmp_path, [first])
    assert "delta" in type(stamp(found)).__name__.lower()
    assert stamp(dated).year == 2023


@pytest.mark.parametrize("height, width", [(50, 50), (200, 120), (301, 200)])
def test_a_laid_view_covers_its_floor_without_what_is_black(height, width):
    image = np.full((height, width, 3), 90, np.uint8)
    image[height // 2 :, : width // 2] = 0
    floor_from_view = np.array([[0.0, -0.01, 2.0], [-0.01, 0.0, 0.01 * (width - 1) / 2], [0.0, 0.0, 1.0]])
    mesh, extent_m = floor_mesh(image, floor_from_view)
    points, triangles = mesh["vertex_positions"], mesh["triangle_indices"]
    assert extent_m == pytest.approx(0.01 * max(height, width), abs=0.05)
    a, b, c = (points[triangles[:, n], :2] for n in range(3))
    one, other = b - a, c - a
    area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum() / 2
    assert area == pytest.approx(0.75 * height * width * 1e-4, rel=0.05)
    used = points[np.unique(triangles)]
    assert not ((used[:, 0] < 1.9 - 0.01 * height * 0.6) & (used[:, 1] > 0.01 * width * 0.1)).any()
    assert max(mesh["albedo_texture"].shape) <= 96


def test_a_run_is_not_held_up_by_a_viewer_that_stands_still(tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    monkeypatch.setattr(live, "PATIENCE_S", 0.2)
    shown = Live(save=tmp_path / "run.rrd")
    (painter,) = shown._painters
    os.kill(painter.process.pid, signal.SIGSTOP)
    large = np.zeros((200, 200, 3), np.uint8)
    slowest = 0.0
    for k in range(200):
        start = time.perf_counter()
        shown.show(
            update(0.1 * k, k, k, np.zeros(3), view=large, closures=(closure(k, 0),)),
            FLOOR_FROM_VIEW,
        )
        slowest = max(slowest, time.perf_counter() - start)
    assert slowest < 1.0 and painter.left_out > 100
    assert (199, 0) in painter.missed and len(painter.missed) > 50
    (note,) = shown.close()
    assert "stopped" in note and "run.rrd" in note
    assert shown.close() == ()


def test_closures_that_were_left_out_come_with_the_next(tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    monkeypatch.setattr(live, "WAITING", 2)
    shown = Live(save=tmp_path / "run.rrd")
    (painter,) = shown._painters
    os.kill(painter.process.pid, signal.SIGSTOP)
    large = np.zeros((200, 200, 3), np.uint8)
    for k in range(8):
        shown.show(
            update(0.1 * k, k, k, np.zeros(3), view=large, closures=(closure(k, 0),)),
            FLOOR_FROM_VIEW,
        )
    os.kill(painter.process.pid, signal.SIGCONT)
    while painter.waiting.full():
        time.sleep(0.01)
    shown.show(update(1.0, 9, None, np.zeros(3), path=np.zeros((9, 3))), FLOOR_FROM_VIEW)
    (note,) = shown.close()
    assert "of 9 frames were left out" in note
    said = [row["TextLog:text"][0].split()[0] for row in rows_of(tmp_path / "run.rrd")["/log"]]
    assert sorted(said) == [str(k) for k in range(8)]


KILLED = """
import numpy as np, os, signal, sys, time
from ebjax.slam.frame import Update
from ebjax.viz.live import Live

shown = Live(save=sys.argv[1])
view, here = np.full((100, 100, 3), 90, np.uint8), np.zeros(3)
for k in range(50):
    shown.show(Update(k, float(k), k, here, None, np.eye(3), view=view), np.eye(3))
print(shown._painters[0].process.pid, flush=True)
while not shown._painters[0].waiting.empty():
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_run_that_is_killed_leaves_its_recording(tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    path = tmp_path / "run.rrd"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    end = time.monotonic() + 20
    while running(done.stdout.strip()):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert len(rows_of(path)["/milliseconds"]) >= 49


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except FileNotFoundError:
        return False


def test_without_rerun_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(live.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r'python -m pip install "ebjax\[viz\]"'):
        Live(save=tmp_path / "run.rrd")
    assert not list(tmp_path.iterdir())


def test_a_viewer_needs_a_screen(monkeypatch):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ValueError, match=r"no screen.*--save-rrd FILE"):
        Live(spawn=True)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    with pytest.raises(OSError, match="directory"):
        Live(save=tmp_path)


def test_the_process_that_draws_loads_no_jax():
    code = "import sys, ebjax.viz.live_scene; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_process_that_ends_before_the_run_is_told(tmp_path):
    pytest.importorskip("rerun", reason="needs rerun-sdk")
    shown = Live(save=tmp_path / "run.rrd")
    shown._painters[0].process.kill()
    shown._painters[0].process.wait()
    for k in range(200):
        shown.show(update(0.1 * k, k, k, np.zeros(3)), FLOOR_FROM_VIEW)
    (note,) = shown.close()
    assert "run.rrd: was closed, or failed, before the run ended" in note


def test_what_rerun_says_when_it_does_not_start_is_one_line(tmp_path, monkeypatch):
    broken = tmp_path / "rerun"
    broken.mkdir()
    (broken / "__init__.py").write_text("raise ImportError('no\\nwheel')")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    (tmp_path / "run.rrd").write_bytes(b"older")
    with pytest.raises(ValueError, match=r"run\.rrd: rerun does not start: ImportError: no wheel"):
        Live(save=tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").read_bytes() == b"older"
