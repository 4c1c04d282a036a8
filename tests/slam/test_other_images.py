import json
import shutil

import cv2
import numpy as np
import pytest

from ebjax.command import run
from ebjax.slam.__main__ import Config, main

pytestmark = pytest.mark.usefixtures("unpainted")


def stored_with_orientation(content, orientation):
    """A JPEG's bytes with an EXIF segment that says its orientation; the pixels stay."""
    tiff = b"II*\0\x08\0\0\0" + b"\1\0" + b"\x12\1\3\0\1\0\0\0" + bytes([orientation, 0, 0, 0]) + bytes(4)
    segment = b"Exif\0\0" + tiff
    return content[:2] + b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment + content[2:]


def edit_camera(folder, change):
    path = folder / "camera.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


def doubled(camera):
    centre = {key: 2 * camera[key] + 0.5 for key in ("cx", "cy")}
    return camera | {key: 2 * camera[key] for key in ("fx", "fy", "width", "height")} | centre


def slam(sequence, out, *flags):
    run(main, Config, [str(sequence), "--out", str(out), *flags])
    return json.loads((out / "metrics.json").read_text())


@pytest.mark.whole
def test_an_association_exif_and_another_resolution_change_nothing_and_are_said(done, sequence, tmp_path, capsys):
    for path in (sequence / "rgb").iterdir():
        path.write_bytes(stored_with_orientation(path.read_bytes(), 3))
    lists = [(sequence / name).read_text().splitlines() for name in ("rgb.txt", "depth.txt")]
    pairs = [f"{a} {b}" for a, b in zip(*lists, strict=True) if not a.startswith("#")]
    (sequence / "rgb.txt").write_text("\n".join(pairs))
    (sequence / "depth.txt").unlink()
    edit_camera(sequence, doubled)
    capsys.readouterr()
    metrics = slam(sequence, tmp_path / "run")
    said = capsys.readouterr().out
    for words in (
        "are an association of colour and depth",
        "orientation 3; they are read as stored",
        "scaled to the",
    ):
        assert said.count(words) == 1
    for name in ("frames", "closures_kept", "closures_by_depth", "closures_against_truth"):
        assert metrics[name] == done.metrics[name]
    assert metrics["ate_rmse_m"]["after"] == pytest.approx(done.metrics["ate_rmse_m"]["after"], abs=1e-6)


def in_colours(path):
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(path), cv2.applyColorMap((depth >> 8).astype(np.uint8), cv2.COLORMAP_JET))


@pytest.mark.slow
@pytest.mark.parametrize(
    "spoil, words",
    [
        (
            lambda folder: edit_camera(folder, lambda camera: camera | {"height": 360}),
            "camera.json: a camera of 640 x 360 px, but the images have 640 x 480, another shape",
        ),
        (lambda folder: shutil.rmtree(folder / "rgb"), "rgb.txt: none of 12 images looked at is there, first "),
        (
            lambda folder: [in_colours(path) for path in (folder / "depth").iterdir()],
            "depth.txt: none of 5 depth images looked at can be used; first ",
        ),
    ],
    ids=["camera", "moved", "depth"],
)
def test_what_fails_alike_in_all_frames_is_one_line_with_its_cause(sequence, tmp_path, capsys, spoil, words):
    spoil(sequence)
    with pytest.raises(SystemExit) as stop:
        run(main, Config, [str(sequence), "--out", str(tmp_path / "run")])
    lines = capsys.readouterr().err.strip().splitlines()
    assert stop.value.code == 2 and len(lines) == 1 and words in lines[0] and "repair" not in lines[0]
