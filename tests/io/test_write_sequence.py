import contextlib

import numpy as np
import pytest

from ebjax.io.camera_file import CameraFile
from ebjax.io.sequence import read_sequence
from ebjax.io.write_sequence import write_sequence

CAMERA = CameraFile(np.diag([50.0, 50.0, 1.0]), np.eye(4), 32, 24, 1000.0)


def frame(i):
    return np.full((24, 32, 3), 10 * i, np.uint8), np.full((24, 32), 1000 + i, np.uint16)


def arguments(count):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(count)
    return np.arange(count) / 10, poses, poses


def test_what_is_written_is_read(tmp_path):
    stamps, odometry, truth = arguments(5)
    seen = []
    write_sequence(
        tmp_path / "run", stamps, odometry, truth, CAMERA, frame, progress=lambda items, n: seen.append(n) or items
    )
    run = read_sequence(tmp_path / "run", depth=True)
    assert seen == [5] and len(run) == 5
    np.testing.assert_allclose(run.timestamps, stamps)
    np.testing.assert_allclose(run.world_from_base, truth)
    np.testing.assert_allclose(run.camera.intrinsics, CAMERA.intrinsics)
    assert np.all(run.depth(4) == np.float32(1.004)) and np.abs(run.rgb(3).astype(int) - 30).max() <= 1


def test_an_interrupted_run_leaves_nothing(tmp_path):
    def breaks(i):
        if i == 3:
            raise KeyboardInterrupt
        return frame(i)

    with pytest.raises(KeyboardInterrupt):
        write_sequence(tmp_path / "run", *arguments(6), CAMERA, breaks)
    assert not list(tmp_path.iterdir())


def test_an_interrupted_run_is_gone_on_with_where_that_is_asked_for(tmp_path):
    made = []

    def breaks(i):
        if i == 3 and 3 not in made:
            made.append(i)
            raise KeyboardInterrupt
        made.append(i)
        return frame(i)

    for interrupted in (True, False):
        with pytest.raises(KeyboardInterrupt) if interrupted else contextlib.nullcontext():
            write_sequence(tmp_path / "run", *arguments(6), CAMERA, breaks, threads=1, resume=True)
    assert sorted(made) == [0, 1, 2, 3, 3, 4, 5] and [file.name for file in tmp_path.iterdir()] == ["run"]
    write_sequence(tmp_path / "other", *arguments(6), CAMERA, frame)
    for file in (tmp_path / "run").rglob("*.*"):
        assert file.read_bytes() == (tmp_path / "other" / file.relative_to(tmp_path / "run")).read_bytes()
