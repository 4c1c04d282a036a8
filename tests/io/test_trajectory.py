import gzip

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.io.poses import poses_from
from ebjax.io.trajectory import read, read_tum, write_kitti, write_tum


@pytest.fixture
def poses():
    rng = np.random.default_rng(0)
    return poses_from(Rotation.random(30, rng=0).as_matrix(), rng.normal(size=(30, 3)) * 100)


@pytest.fixture
def times():
    return 1.6e9 + np.arange(30) * 0.033


def test_tum_round_trip(tmp_path, poses, times):
    write_tum(tmp_path / "a.tum", times, poses, comment="odom_from_base")
    back = read(tmp_path / "a.tum")
    assert back.timed
    np.testing.assert_allclose(back.timestamps, times, atol=1e-6, rtol=0)
    np.testing.assert_allclose(back.poses, poses, atol=1e-8)
    assert (tmp_path / "a.tum").read_text().startswith("# odom_from_base\n# timestamp tx ty tz qx qy qz qw\n")


def test_tum_is_xyzw(tmp_path):
    (tmp_path / "a.tum").write_text("# c\n\n5.0, 1, 2, 3, 0, 0, 0.70710678, 0.70710678\n")
    pose = read_tum(tmp_path / "a.tum").poses[0]
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-8)


def test_kitti_round_trip_and_gzip(tmp_path, poses):
    write_kitti(tmp_path / "a.txt", poses)
    (tmp_path / "a.gz").write_bytes(gzip.compress((tmp_path / "a.txt").read_bytes()))
    back = read(tmp_path / "a.gz")
    assert not back.timed
    np.testing.assert_array_equal(back.timestamps, np.arange(30))
    np.testing.assert_allclose(back.poses, poses, atol=1e-11)


def test_a_packed_neighbour_stands_in(tmp_path, poses):
    write_kitti(tmp_path / "a.kitti", poses)
    (tmp_path / "a.kitti.gz").write_bytes(gzip.compress((tmp_path / "a.kitti").read_bytes()))
    (tmp_path / "a.kitti").unlink()
    assert len(read(tmp_path / "a.kitti").poses) == len(poses)


GOOD = "1.0 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "no poses"),
        (GOOD + "2.0 0 0 0 0 0 0\n", "line 2: 7 columns, but line 1 has 8"),
        (
            "# c\n" + GOOD + "0.5 0 0 0 0 0 0 1\n",
            "line 3: timestamp 0.500000 is earlier than 1.* line 2; sort the file",
        ),
        (GOOD + "1.0 1 0 0 0 0 0 1\n", r"line 2: another pose at timestamp 1\.000000, which is also line 1's"),
        (GOOD + "1.0 0 0 0 0 0 1 0\n", "line 2: another pose at timestamp 1.*remove one of the two"),
    ],
)
def test_bad_files_name_file_and_line(tmp_path, text, words):
    (tmp_path / "bad.txt").write_text(text)
    for reader in (read, read_tum):
        with pytest.raises(ValueError, match=f"bad.txt.*{words}"):
            reader(tmp_path / "bad.txt")


@pytest.mark.parametrize("text", ["1 0 0 0 0 1 0 0 0 0 1 0\n", "1 2 90\n", "VERTEX_SE2 0 0 0 0\n", "x,y,yaw\n1,2,3\n"])
def test_a_sequence_needs_times(tmp_path, text):
    (tmp_path / "odometry.txt").write_text(text)
    assert not read(tmp_path / "odometry.txt").timed
    with pytest.raises(ValueError, match=r"odometry\.txt: it has no times; give rows `timestamp tx ty tz qx qy qz qw`"):
        read_tum(tmp_path / "odometry.txt")


def rows(times, x):
    return "".join(f"{t} {v} 0 0 0 0 0 1\n" for t, v in zip(times, x, strict=True))


def test_rows_that_repeat_time_and_pose_are_left_out(tmp_path):
    (tmp_path / "twice.txt").write_text(rows([1, 2, 2, 2, 3, 3, 4], [0, 1, 1, 1, 2, 2, 2]))
    for reader in (read, read_tum):
        found = reader(tmp_path / "twice.txt")
        np.testing.assert_array_equal(found.timestamps, [1, 2, 3, 4])
        assert "3 rows repeat the row before, time and pose, and are left out: lines 3-4, 6" in found.notes[0]


def test_the_same_pose_at_later_times_stays(tmp_path):
    (tmp_path / "stands.txt").write_text(rows([1, 2, 3, 4], [0, 0, 0, 0]))
    found = read(tmp_path / "stands.txt")
    assert len(found.poses) == 4 and found.notes == ()


def test_a_near_pose_at_the_same_time_is_a_rounded_stamp(tmp_path):
    (tmp_path / "mocap.txt").write_text(rows([0, 1, 2, 2, 3, 4], [0, 0.1, 0.2, 0.25, 0.3, 0.4]))
    found = read(tmp_path / "mocap.txt")
    assert len(found.poses) == 6 and "line 4 (kept)" in found.notes[0]
    found = read_tum(tmp_path / "mocap.txt")
    np.testing.assert_array_equal(found.poses[:, 0, 3], [0, 0.1, 0.2, 0.3, 0.4])
    assert "line 4 (left out)" in found.notes[0]
    (tmp_path / "mocap.txt").write_text(rows([0, 1, 2, 2, 3, 4], [0, 0.1, 0.2, 5, 0.3, 0.4]))
    with pytest.raises(ValueError, match="line 4: another pose"):
        read(tmp_path / "mocap.txt")


def test_lost_rows_leave_times_that_increase(tmp_path):
    text = rows([1, 2, 3, 4], [0, 1, 2, 3]).splitlines()
    text[1:3] = ["2 0 0 0 0 0 0 0", "nan nan nan nan nan nan nan nan"]
    (tmp_path / "lost.txt").write_text("\n".join(text))
    np.testing.assert_array_equal(read_tum(tmp_path / "lost.txt").timestamps, [1, 4])


def test_unreadable_bytes(tmp_path):
    whole = gzip.compress(GOOD.encode() * 50)
    for name, content in {"cut.gz": whole[:-12], "binary": b"\xff\xfe\x00\x80"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=name):
            read(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "absent")


def test_evo_reads_what_we_write(tmp_path, poses, times, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # evo writes a settings folder in the home
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_tum(tmp_path / "a.tum", times, poses)
    evo = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    assert evo.check()[0]
    np.testing.assert_allclose(np.array(evo.poses_se3), poses, atol=1e-8)
