"""Seeds that are text: trajectories, pose graphs, calibrations, configs, truth of retrieval, pairs, run folders."""

import csv
import gzip
import io
import json

import numpy as np

from .mutate import Input
from .seed_images import jpeg_of, png_of

K = [400.0, 0.0, 320.0, 0.0, 410.0, 240.0, 0.0, 0.0, 1.0]
MOUNT = [[0.0, -0.5, 0.8660254037844386, 0.2], [-1, 0, 0, 0], [0, -0.8660254037844386, -0.5, 0.5], [0, 0, 0, 1]]
CAMERA = {"fx": 30.0, "fy": 30.0, "cx": 15.5, "cy": 11.5, "width": 32, "height": 24, "depth_scale": 1000.0}
CAMERA["T_base_camera"] = MOUNT


def text(name: str, content: str | bytes) -> Input:
    """One file."""
    return Input({name: content.encode() if isinstance(content, str) else content}, name)


def tum_rows(count: int, start: float = 100.0, columns: str = "") -> str:
    """A turn to the left."""
    yaw = 0.1 * np.arange(count)
    rows = (f"{start + 0.2 * k:.6f} {0.1 * k:.6f} {0.01 * k:.6f} 0 0 0 {np.sin(a / 2):.9f} {np.cos(a / 2):.9f}"
            for k, a in enumerate(yaw))  # fmt: skip
    return "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(rows) + f"\n{columns}"


def trajectories() -> list[Input]:
    kitti = "\n".join(f"1 0 0 {k} 0 1 0 0.5 0 0 1 {2 * k}" for k in range(6))
    g2o = graphs()[0].files["se2.g2o"]
    return [
        *(text("tum.txt", tum_rows(8)), text("tum.csv", tum_rows(5).replace(" ", ",")), text("kitti.txt", kitti)),
        *(text("planar.txt", "0 0 0\n1 0.5 10\n2 1 20.5\n"), Input({"poses.g2o": g2o}, "poses.g2o")),
        text("tum.txt.gz", gzip.compress(tum_rows(6).encode(), mtime=0)),
        text("euroc.csv", "#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z\n" + "\n".join(
            f"{1403636579763555584 + 10**8 * k},{0.1 * k},0,0,1,0,0,0" for k in range(4))),
    ]  # fmt: skip


def graphs() -> list[Input]:
    upper3 = "100 0 0 100 0 400"
    upper6 = " ".join("100" if place in (0, 6, 11, 15, 18, 20) else "0" for place in range(21))
    se2 = [f"VERTEX_SE2 {k} {k} 0.{k} 0.1" for k in range(5)] + ["FIX 0"]
    se2 += [f"EDGE_SE2 {k} {k + 1} 1 0 0.1 {upper3}" for k in range(4)] + [f"EDGE_SE2 0 4 4 0 0.4 {upper3}"]
    se3 = [f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1" for k in range(4)]
    se3 += [f"EDGE_SE3:QUAT {k} {k + 1} 1 0 0 0 0 0 1 {upper6}" for k in range(3)]
    toro = ["VERTEX2 0 0 0 0", "VERTEX2 1 1 0 0", "EDGE2 0 1 1 0 0 100 0 100 400 0 0"]
    sparse = ["VERTEX_SE2 7 0 0 0", f"EDGE_SE2 7 900 1 0 0 {upper3}", f"EDGE_SE2 900 12 1 0 0 {upper3}"]
    prior = [*se2, "PARAMS_SE2OFFSET 0 0 0 0", f"EDGE_SE2_PRIOR 0 0 0 0 {upper3}", "VERTEX_XY 9 1 1"]
    prior += ["EDGE_SE2_XY 0 9 1 1 1 0 1", f"EDGE_SE2_SWITCHABLE 0 2 2 0 0.2 {upper3}"]
    names = {"se2": se2, "se3": se3, "toro": toro, "sparse": sparse, "edges": se2[6:], "prior": prior}
    return [text(f"{name}.g2o", "\n".join(lines) + "\n") for name, lines in names.items()]


def configs() -> list[Input]:
    nested = "steps: 10\nrate: 1e-3\nname: a\nsizes: [1, 2]\ninner: {low: 0.5, high: [1, 2]}\nway: fast\npath: a\n"
    return [text("config.yaml", nested), text("few.yaml", "# differences\nrate: 0.5\n"), text("none.yaml", "")]


def truths() -> list[Input]:
    return [text("truth.json", json.dumps({str(k): [k, (k + 1) % 5] for k in range(5)})), text("none.json", "{}")]


def pair_folders() -> list[Input]:
    truth = {"quad": [[4, 4], [28, 4], [30, 20], [2, 20]], "H_a_to_b": [[1, 0, 2], [0, 1, 1], [0, 0, 1]]}
    files = {f"one/{side}.png": png_of(32, 24) for side in "ab"} | {f"two/{side}.jpg": jpeg_of(32, 24) for side in "ab"}
    files |= {f"{name}/gt.json": json.dumps(truth).encode() for name in ("one", "two")}
    return [Input(files, "")]


def run_folders() -> list[Input]:
    covariance = [1e-4, 0, 0, 1e-4, 0, 1e-5]
    names = [*"ij", "time_i_s", "time_j_s", "x_m", "y_m", "theta_rad"]
    names += ["cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt"]
    files = {}
    for name, more, values in (
        ("steps.csv", ["gap", "kind", "used"], [1, "floor", 1]),
        ("loop_closures.csv", ["kept", "reason"], [1, "kept"]),
    ):
        out = io.StringIO()
        table = csv.writer(out, lineterminator="\n")
        table.writerow([*names, *more])
        for k in range(5):
            table.writerow([k, k + 1, 100 + 0.2 * k, 100.2 + 0.2 * k, 0.1, 0.01, 0.1, *covariance, *values])
        files[name] = out.getvalue().encode()
    files |= {"trajectory.tum": tum_rows(8).encode(), "groundtruth.txt": tum_rows(8).encode()}
    files["metrics.json"] = json.dumps({"frames": 8, "motion": {"scale_sigma": 0.01}, "ate_rmse_m": None}).encode()
    files["pose_graph.g2o"] = graphs()[0].files["se2.g2o"]
    return [Input(files, "")]
