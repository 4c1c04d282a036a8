import gzip

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.io.poses import poses_from
from ebjax.io.trajectory import read, read_kitti, read_tum, write_kitti, write_tum


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


def test_planar_rows_and_g2o_vertices_agree(tmp_path):
    (tmp_path / "a.txt").write_text("1 2 90\n3 4 -180\n")
    (tmp_path / "a.g2o").write_text(
        f"VERTEX_SE2 7 1 2 {np.pi / 2}\nVERTEX_SE2 3 3 4 {-np.pi}\nEDGE_SE2 7 3 1 0 0 1 0 0 1 0 1\n"
    )
    (tmp_path / "b.g2o").write_text(
        "EDGE_SE3:QUAT 0 1 1\nVERTEX_SE3:QUAT 0 1 2 0 0 0 0.70710678118 0.70710678118\n"
        "VERTEX_SE3:QUAT 1 3 4 0 0 0 1 0\nFIX 0\n"
    )
    planar = read(tmp_path / "a.txt")
    np.testing.assert_allclose(planar.poses[0] @ [1, 0, 0, 1], [1, 3, 0, 1], atol=1e-12)
    for name in ("a.g2o", "b.g2o"):
        np.testing.assert_allclose(read(tmp_path / name).poses, planar.poses, atol=1e-9)


GOOD = "1.0 0 0 0 0 0 0 1\n"
KITTI = "1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "no poses"),
        ("# only a comment\n", "no poses"),
        (GOOD + "2.0 0 0 0 0 0 0\n", "line 2: 7 columns"),
        (GOOD + "2.0 0 nan 0 0 0 0 1\n", "line 2: nan is not a finite"),
        (GOOD + "2.0 0 x 0 0 0 0 1\n", "line 2: 'x' is not a number"),
        ("# c\n" + GOOD + "0.5 0 0 0 0 0 0 1\n", "line 3: timestamp 0.500000 is earlier.*sort"),
        (GOOD + "2.0 0 0 0 0 0 0 0\n", "line 2: the quaternion"),
        (KITTI + "2 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: not a pose"),
        (KITTI + "-1 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: not a pose.*reflection"),
        ("1 2\n", "line 1: 2 columns"),
        ("VERTEX_SE2 0 1 2\n", "line 1: a VERTEX_SE2 line with 2"),
        ("VERTEX_SE2 0 1 2 0\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n", "line 2: .*one kind"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", "no VERTEX"),
    ],
)
def test_bad_files_name_file_and_line(tmp_path, text, words):
    (tmp_path / "bad.txt").write_text(text)
    with pytest.raises(ValueError, match=f"bad.txt.*{words}"):
        read(tmp_path / "bad.txt")


def test_duplicate_timestamps_are_refused_only_where_they_matter(tmp_path):
    (tmp_path / "twice.txt").write_text(GOOD + GOOD)
    assert len(read(tmp_path / "twice.txt").poses) == 2
    with pytest.raises(ValueError, match=r"line 2: timestamp 1\.000000 is also line 1's"):
        read_tum(tmp_path / "twice.txt")


def test_unreadable_bytes(tmp_path):
    whole = gzip.compress(GOOD.encode() * 50)
    for name, content in {"cut.gz": whole[:-12], "binary": b"\xff\xfe\x00\x80"}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=name):
            read(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        read_kitti(tmp_path / "absent")


def test_evo_reads_what_we_write(tmp_path, poses, times, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # evo writes a settings folder in the home
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_tum(tmp_path / "a.tum", times, poses)
    evo = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    assert evo.check()[0]
    np.testing.assert_allclose(np.array(evo.poses_se3), poses, atol=1e-8)
