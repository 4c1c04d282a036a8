"""Vertices of pose graphs under every tag that programs write."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ebjax.io.trajectory import read

POSES = [(1.0, 2.0, np.pi / 2), (3.0, 4.0, -np.pi), (-5.5, 0.25, 0.1)]


def graph(tag):
    lines = ["# c", "PARAMS_SE2OFFSET 0 0 0 0"]
    for k, (x, y, theta) in enumerate(POSES):
        qx, qy, qz, qw = Rotation.from_euler("z", theta).as_quat()
        if "QUAT" in tag:
            values = [x, y, 0, qx, qy, qz, qw]
        else:
            values = [x, y, theta] if "3" not in tag else [x, y, 0, 0, 0, theta]
        lines.append(" ".join([tag, str(7 - k), *(f"{v:.12f}" for v in values)]))
    return "\n".join([*lines, "EDGE_SE2 7 6 1 0 0 1 0 0 1 0 1", "FIX 7"]) + "\n"


TAGS = ["VERTEX_SE2", "VERTEX_SE3:QUAT", "VERTEX2", "VERTEX3", "ONLINE_VERTEX_SE2", "TUTORIAL_VERTEX_SE2"]
TAGS += ["ONLINE_VERTEX_SE3:QUAT"]


@pytest.mark.parametrize("tag", TAGS)
@pytest.mark.parametrize("commas", [False, True])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_vertices(tmp_path, tag, commas, mark):
    text = mark + (graph(tag).replace(".", ",") if commas else graph(tag))
    (tmp_path / "a.g2o").write_text(text, encoding="utf-8")
    found = read(tmp_path / "a.g2o")
    assert not found.timed and found.notes == (f"{found.path}: commas are decimal, read as points",) * commas
    np.testing.assert_allclose(found.poses[:, :2, 3], [pose[:2] for pose in POSES])
    expected = Rotation.from_rotvec([[0, 0, pose[2]] for pose in POSES]).as_matrix()
    np.testing.assert_allclose(found.poses[:, :3, :3], expected, atol=1e-9)


def test_roll_and_pitch_of_vertex3(tmp_path):
    (tmp_path / "a.graph").write_text("VERTEX3 0 1 2 3 0.1 0.2 0.3\n")
    expected = Rotation.from_euler("ZYX", [0.3, 0.2, 0.1]).as_matrix()
    np.testing.assert_allclose(read(tmp_path / "a.graph").poses[0, :3, :3], expected, atol=1e-12)


def test_vertices_agree_with_planar_rows(tmp_path):
    (tmp_path / "a.txt").write_text("".join(f"{x} {y} {np.degrees(theta)}\n" for x, y, theta in POSES))
    (tmp_path / "a.g2o").write_text(graph("VERTEX_SE2"))
    np.testing.assert_allclose(read(tmp_path / "a.txt").poses, read(tmp_path / "a.g2o").poses, atol=1e-9)


def test_landmarks_are_left_out_and_said(tmp_path):
    (tmp_path / "a.g2o").write_text(graph("VERTEX_SE2") + "VERTEX_XY 100 1 2\nVERTEX_XY 101 1 2\n")
    found = read(tmp_path / "a.g2o")
    assert len(found.poses) == 3 and found.notes == (
        f"{found.path}: 2 VERTEX_XY lines, no poses of the path, are left out",
    )


@pytest.mark.parametrize(
    "text, words",
    [
        ("VERTEX_SE2 0 1 2\n", "line 1: a VERTEX_SE2 line with 2 numbers after the id; VERTEX_SE2 has 3"),
        ("VERTEX_SE2 0 1 2 0\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n", "line 2: .*one kind a file"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n", "no vertices with poses"),
        ("VERTEX_XY 0 1 2\n", "no vertices with poses"),
        ("VERTEX_SE3:QUAT 1 0 0 0 0 0 0 2\n", "line 1: the quaternion's length is not 1"),
        ("VERTEX_SE2 0 1 nan 0\n", "line 1: nan is not a finite number"),
        ("VERTEX_SE2\n", "line 1: a VERTEX_SE2 line with 0 numbers"),
    ],
)
def test_bad_graphs_name_file_and_line(tmp_path, text, words):
    (tmp_path / "bad.g2o").write_text(text)
    with pytest.raises(ValueError, match=f"bad.g2o.*{words}"):
        read(tmp_path / "bad.g2o")
