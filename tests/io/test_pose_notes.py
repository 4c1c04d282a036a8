"""What was read of odometry.txt and groundtruth.txt reaches the notes of the log and of the run."""

import json

import cv2
import numpy as np
import pytest

from ebjax.io.logs.open import open_log
from ebjax.io.sequence import read_sequence

TIMES = 1403636579.75 + 0.2 * np.arange(10)
CAMERA = {"fx": 8, "fy": 8, "cx": 4, "cy": 3, "width": 8, "height": 6}
MOUNT = [[0, 0, 1, 0.27], [-1, 0, 0, 0], [0, -1, 0, 0.54], [0, 0, 0, 1]]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rgb").mkdir()
    for k in range(10):
        cv2.imwrite(str(tmp_path / "rgb" / f"{k}.png"), np.full((6, 8, 3), 20 * k, np.uint8))
    (tmp_path / "rgb.txt").write_text("".join(f"{t:.6f} rgb/{k}.png\n" for k, t in enumerate(TIMES)))
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA | {"T_base_camera": MOUNT}))
    return tmp_path


def rows(form):
    return "".join(form.format(t=t, ns=round(t * 1e9), k=k, x=0.1 * k) + "\n" for k, t in enumerate(TIMES))


FORMS = {
    "null rows": (
        rows("{t:.6f} {x} 0 0 0 0 0 1").replace("0.4 0 0 0 0 0 1", "0 0 0 0 0 0 0"),
        "1 of 10 rows hold no pose",
    ),
    "nanoseconds": (rows("{ns} {x} 0 0 0 0 0 1"), "stamps are nanoseconds (by their size), read as seconds"),
    "an id": ("#timestamp x y z qx qy qz qw id\n" + rows("{t:.6f} {x} 0 0 0 0 0 1 {k}"), "are left out: id"),
    "CSV": ("num,t,x,y,z,qx,qy,qz,qw\n" + rows("{k},{t:.6f},{x},0,0,0,0,0,1"), "are left out: num"),
    "decimal commas": (rows("{t:.6f} {x} 0 0 0 0 0 1").replace(".", ","), "commas are decimal"),
}


@pytest.mark.parametrize("name", ["odometry.txt", "groundtruth.txt"])
@pytest.mark.parametrize("form", FORMS)
def test_other_forms_are_read_and_said(folder, name, form):
    text, words = FORMS[form]
    (folder / "odometry.txt").write_text(rows("{t:.6f} {x} 0 0 0 0 0 1"))
    (folder / name).write_text(text)
    assert any(f"{name}: " in note and words in note for note in open_log(folder).notes)
    run = read_sequence(folder)
    poses = run.odom_from_base if name == "odometry.txt" else run.world_from_base
    np.testing.assert_allclose(poses[:, 0, 3], 0.1 * np.arange(10), atol=1e-5)
    assert any(f"{name}: " in note and words in note for note in run.notes)
