"""One run as several programs export it: the error against the same reference is the same, and evo's."""

import numpy as np
import pytest

from ebjax.evaluation.trajectory import ate
from ebjax.io.trajectory import read, write_kitti, write_tum

ATE_M = 0.059269
"""RMSE after an SE(2) alignment, computed with SciPy."""
K = np.arange(41)
TIMES = 1403636579.75 + 0.5 * K
ZERO = 0.0 * K
HEADING = np.pi / 2 * np.sign(np.maximum(K - 19, 0)) + np.pi / 2 * (K > 20)
X, Y = 0.25 * np.minimum(K, 40 - K), 0.2 * (K > 20)


def poses_along(x, y, heading):
    return np.stack([x, y, ZERO, ZERO, ZERO, np.sin(heading / 2), np.cos(heading / 2)], axis=1)


TRUE = poses_along(X, Y, HEADING)
ESTIMATE = poses_along(X + 0.05 * np.sin(0.3 * K), Y + 0.004 * K, HEADING + 0.01 * K / 41)


def rows(poses, stamp="{:.6f}", separator=" ", before=(), behind=()):
    lines = []
    for k, (t, pose) in enumerate(zip(TIMES, poses, strict=True)):
        words = [*(f.format(k) for f in before), stamp.format(t), *(f"{v:.9f}" for v in pose)]
        lines.append(separator.join([*words, *(f.format(k) for f in behind)]))
    return "\n".join(lines) + "\n"


def lost(text, which):
    lines = text.splitlines()
    for k in which:
        lines[k] = lines[k].split()[0] + "  NaN" * 7
    return "\n".join(lines)


NANOSECONDS = [int(t * 1e9) for t in TIMES]
EXPORTS = {
    "TUM": lambda p: rows(p),
    "decimal commas": lambda p: rows(p).replace(".", ","),
    "decimal commas, semicolons": lambda p: rows(p, separator=";").replace(".", ","),
    "nanoseconds": lambda p: "".join(
        f"{int(t) * 10**9 + round(t % 1 * 1e9)}.000000 " + " ".join(f"{v:.9f}" for v in q) + "\n"
        for t, q in zip(TIMES, p, strict=True)
    ),
    "header and number": lambda p: "num,t,x,y,z,qx,qy,qz,qw\n" + rows(p, separator=",", before=["{}"]),
    "header": lambda p: "timestamp,x,y,z,qx,qy,qz,qw\n" + rows(p, separator=","),
    "RTAB-Map 11": lambda p: "#timestamp x y z qx qy qz qw id\n" + rows(p, behind=["{}"]),
    "RTAB-Map 11 without its header": lambda p: rows(p, behind=["{}"]),
    "w first, by the header": lambda p: "t;qw;qx;qy;qz;x;y;z\n" + rows(p[:, [6, 3, 4, 5, 0, 1, 2]], separator=";"),
    "double blanks": lambda p: rows(p, separator="  "),
    "a mark and CR LF": lambda p: "\ufeff" + rows(p, separator=",").replace("\n", "\r\n"),
}


def error(estimate, reference):
    _, i, j = np.intersect1d(reference.timestamps, estimate.timestamps, return_indices=True)
    points = reference.poses[i, :3, 3], estimate.poses[j, :3, 3]
    return len(i), ate(*points, "se2", None)["rmse"]


@pytest.mark.parametrize("name", EXPORTS)
@pytest.mark.parametrize("side", ["estimate", "reference", "both"])
def test_the_error_does_not_depend_on_the_export(tmp_path, name, side):
    for part, poses in (("estimate", ESTIMATE), ("reference", TRUE)):
        make = EXPORTS[name if side in (part, "both") else "TUM"]
        (tmp_path / part).write_text(make(poses), encoding="utf-8", newline="")
    pairs, rmse = error(read(tmp_path / "estimate"), read(tmp_path / "reference"))
    assert pairs == 41 and rmse == pytest.approx(ATE_M, abs=1e-6)


@pytest.mark.parametrize(
    "in_reference, in_estimate", [([4, 5, 6, 19], [29, 30]), ([4, 5, 6, 19], []), ([0, 40], [0, 1])]
)
def test_lost_rows_leave_the_other_pairs(tmp_path, in_reference, in_estimate):
    (tmp_path / "estimate").write_text(lost(rows(ESTIMATE), in_estimate))
    (tmp_path / "reference").write_text(lost(rows(TRUE), in_reference))
    pairs, rmse = error(read(tmp_path / "estimate"), read(tmp_path / "reference"))
    assert pairs == 41 - len({*in_reference, *in_estimate}) and rmse == pytest.approx(ATE_M, abs=0.003)


@pytest.fixture
def file_interface(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # evo writes a settings folder in the home
    return pytest.importorskip("evo.tools.file_interface")


def test_evo_reads_the_same_from_euroc_tum_and_kitti(tmp_path, file_interface):
    rng = np.random.default_rng(0)
    quaternion = rng.normal(size=(41, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    table = np.concatenate([rng.normal(size=(41, 3)), quaternion, np.zeros((41, 9))], axis=1)
    path = tmp_path / "data.csv"
    path.write_text(
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
        + ", v [m s^-1]" * 9
        + "\n"
        + "".join(f"{n}," + ",".join(f"{v:.9f}" for v in r) + "\n" for n, r in zip(NANOSECONDS, table, strict=True))
    )
    evo, ours = file_interface.read_euroc_csv_trajectory(str(path)), read(path)
    np.testing.assert_allclose(np.array(evo.poses_se3), ours.poses, atol=1e-8)
    np.testing.assert_allclose(evo.timestamps, ours.timestamps, rtol=0, atol=1e-6)
    write_tum(tmp_path / "a.tum", ours.timestamps, ours.poses)
    evo = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    np.testing.assert_allclose(np.array(evo.poses_se3), read(tmp_path / "a.tum").poses, atol=1e-9)
    write_kitti(tmp_path / "a.kitti", ours.poses)
    evo = file_interface.read_kitti_poses_file(str(tmp_path / "a.kitti"))
    np.testing.assert_allclose(np.array(evo.poses_se3), read(tmp_path / "a.kitti").poses, atol=1e-9)
