"""A log written in TUM layout reads back as the same run, goes on after an interruption, and names what is left out."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.io.camera_file import read_camera
from ebjax.io.images import BrokenFrame
from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.open import LogOptions, open_log
from ebjax.io.sequence import read_sequence
from ebjax.io.trajectory import read_tum
from ebjax.logs.__main__ import Config, main
from ebjax.logs.convert import convert
from ebjax.logs.frame_bytes import depth_bytes


def written(capsys, log, out, *flags):
    run(main, Config, [str(log), "--out", str(out), *flags], needs_jax=False)
    return capsys.readouterr()


def refused(capsys, log, out, *flags):
    with pytest.raises(SystemExit) as stop:
        written(capsys, log, out, *flags)
    assert stop.value.code == 2
    return capsys.readouterr().err


def same_run(log, out):
    before, after = read_sequence(log), read_sequence(out)
    assert len(before) == len(after)
    np.testing.assert_allclose(after.timestamps, before.timestamps, atol=1e-6)
    np.testing.assert_allclose(after.odom_from_base, before.odom_from_base, atol=1e-6)
    np.testing.assert_allclose(after.odometry.poses, before.odometry.poses, atol=1e-6)
    np.testing.assert_allclose(after.camera.intrinsics, before.camera.intrinsics)
    np.testing.assert_allclose(after.camera.base_from_camera, before.camera.base_from_camera, atol=1e-9)
    assert after.camera.distortion == before.camera.distortion
    return before, after


def test_a_bag(capsys, bag, tmp_path):
    captured = written(capsys, bag, tmp_path / "out")
    assert captured.out.splitlines()[-1].startswith(f"{tmp_path / 'out'}: 8 images, 8 depth images written")
    before, after = same_run(bag, tmp_path / "out")
    for k in range(len(before)):
        assert np.abs(after.rgb(k).astype(int) - before.rgb(k)).mean() < 2
        np.testing.assert_allclose(after.depth(k), before.depth(k), atol=1e-6)
    assert read_camera(tmp_path / "out" / "camera.json").depth_scale == 1000
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        *("rgb", "depth", "rgb.txt", "depth.txt", "odometry.txt", "camera.json", "config.yaml")
    }
    assert not list(tmp_path.glob(".*"))


def test_a_folder_keeps_its_files(capsys, folder, tmp_path):
    shutil.copy(folder / "odometry.txt", folder / "groundtruth.txt")
    written(capsys, folder, tmp_path / "out")
    same_run(folder, tmp_path / "out")
    for file in (folder / "rgb").iterdir():
        assert (tmp_path / "out" / "rgb" / file.name).read_bytes() == file.read_bytes()
    truth = read_tum(folder / "groundtruth.txt"), read_tum(tmp_path / "out" / "groundtruth.txt")
    np.testing.assert_allclose(truth[1].poses, truth[0].poses, atol=1e-6)


def test_stored_images_are_taken_only_where_they_show_the_same(folder, tmp_path):
    log = open_log(folder)
    camera = camera_of(log)[0]
    content = [cv2.imencode(".png", log.colour.decode(k)[:, :, ::-1] // (1 + k % 2))[1].tobytes() for k in range(6)]
    colour = replace(log.colour, files=(), stored=lambda k: None if k == 4 else content[k])
    convert(replace(log, colour=colour), camera, tmp_path / "out")
    suffixes = [path.suffix for path in sorted((tmp_path / "out" / "rgb").iterdir())]
    # The first is black, and half of black is black; the third and fourth differ, the fifth is not stored.
    assert suffixes == [".png", ".jpg", ".png", ".jpg", ".jpg", ".jpg"]


def test_goes_on_after_an_interruption(folder, tmp_path, capsys):
    log, out, decoded = open_log(folder), tmp_path / "out", []
    camera = camera_of(log)[0]

    def decode(k):
        decoded.append(k)
        return log.colour.decode(k)

    counted = replace(log, colour=replace(log.colour, decode=decode))

    def stopped(rows, total):
        for row in rows:
            if row == 3:
                raise KeyboardInterrupt
            yield row

    with pytest.raises(KeyboardInterrupt):
        convert(counted, camera, out, progress=stopped)
    assert "3 images are written; the same command goes on" in capsys.readouterr().err
    assert not out.exists() and decoded == [0, 1, 2]
    (tmp_path / ".out.partial" / "rgb" / ".100.600000.jpg.part").write_bytes(b"cut")  # killed while it wrote
    result = convert(counted, camera, out)
    assert "goes on where the last call stopped" in capsys.readouterr().err
    assert decoded == [0, 1, 2, 3, 4, 5] and len(result.colour) == 6
    same_run(folder, out)
    assert len(list((out / "rgb").iterdir())) == 6 and not (tmp_path / ".out.partial").exists()


@pytest.mark.parametrize("change", ["options", "log"])
def test_what_is_begun_of_another_log_is_not_mixed_in(folder, tmp_path, capsys, change):
    log, out = open_log(folder), tmp_path / "out"

    def stopped(rows, total):
        yield 0
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(log, camera_of(log)[0], out, progress=stopped)
    options = LogOptions()
    if change == "options":
        options = LogOptions(session=1)
    else:
        (folder / "rgb" / "100.000000.jpg").write_bytes((folder / "rgb" / "100.200000.jpg").read_bytes())
    convert(log, camera_of(log)[0], out, options=options)
    assert "starts anew" in capsys.readouterr().err
    assert (out / "rgb" / "100.000000.jpg").read_bytes() == (folder / "rgb" / "100.000000.jpg").read_bytes()


def test_broken_images_are_left_out_and_listed(capsys, folder, tmp_path):
    files = sorted((folder / "rgb").iterdir())
    files[1].write_bytes(files[1].read_bytes()[:200])
    cv2.imwrite(str(files[2]), np.zeros((48, 64, 3), np.uint8))
    out = written(capsys, folder, tmp_path / "out").out
    assert f"left out: {files[1]}: truncated JPEG" in out and "64x48 pixels, but most images have 32x24" in out
    assert "4 images, 0 depth images written" in out
    assert len((tmp_path / "out" / "left_out.txt").read_text().splitlines()) == 2
    assert len(read_sequence(tmp_path / "out")) == 4
    for file in files:
        file.write_bytes(b"no image")
    assert "none of 6 images looked at can be read; first" in refused(capsys, folder, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_broken_depth_image_costs_only_itself(bag, tmp_path):
    log = open_log(bag)

    def decode(k):
        if k == 2:
            raise BrokenFrame("depth 2: damaged")
        return log.depth.decode(k) + np.float32(0.0003)

    broken = replace(log, depth=replace(log.depth, decode=decode))
    result = convert(broken, camera_of(log)[0], tmp_path / "out")
    assert len(result.colour) == 8 and len(result.depth) == 7 and result.left_out == ["depth 2: damaged"]
    assert result.rounded_mm == pytest.approx(0.3, abs=0.01)
    assert "rounded to millimetres, by 0.3 mm at most" in "\n".join(result.lines())


def test_depth_in_millimetres():
    depth = np.array([[0, 1.0004, 1.0006, 65.534, 65.535, 700.0, np.nan, -1]], np.float32)
    content, rounding, far = depth_bytes(depth)
    units = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert units.tolist() == [[0, 1000, 1001, 65534, 0, 0, 0, 0]] and units.dtype == np.uint16
    assert rounding == pytest.approx(0.4, abs=0.01) and far == 2


def test_refuses_before_any_work(capsys, folder, tmp_path):
    out = tmp_path / "out"
    assert "lies in the log" in refused(capsys, folder, folder / "out")
    (folder / "camera.json").unlink()
    assert "there is no camera.json" in refused(capsys, folder, out)
    out.mkdir()
    (out / "mine.txt").touch()
    assert "is there already" in refused(capsys, folder, out)
    assert (out / "mine.txt").exists() and not list(tmp_path.glob(".*"))


def test_json_says_what_was_written(capsys, folder, tmp_path):
    found = json.loads(written(capsys, folder, tmp_path / "out", "--json").out)
    assert found["written"]["images"] == 6 and found["written"]["path"] == str(tmp_path / "out")
    assert found["images"]["count"] == 6


def test_a_real_database(capsys, data, tmp_path):
    log = data("logs") / "rtabmap" / "corridor_v0.23.8_86_nodes.db"
    written(capsys, log, tmp_path / "out")
    before, after = same_run(log, tmp_path / "out")
    for k in (0, 40, 85):
        assert np.abs(after.rgb(k).astype(int) - before.rgb(k)).mean() < 2
        np.testing.assert_allclose(after.depth(k), before.depth(k), atol=5.1e-4)
