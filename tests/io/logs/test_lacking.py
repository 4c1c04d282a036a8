"""What a log lacks is asked for in one message, and a user who does what it says has a run."""

import json
import re
import shlex

import cv2
import numpy as np
import pytest

from ebjax.io.logs.camera import camera_of
from ebjax.io.logs.mount_options import MountOptions
from ebjax.io.logs.open import open_log
from ebjax.io.sequence import read_sequence

WIDTH, HEIGHT, COUNT = 64, 48, 3
INTRINSICS = {"width": WIDTH, "height": HEIGHT, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "depth_scale": 1000}


def photograph(folder, names=("0.png", "1.png", "2.png")):
    folder.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((HEIGHT, WIDTH, 3), 40 * k, np.uint8))
    return names


def refused(folder):
    with pytest.raises(ValueError) as fault:
        read_sequence(folder)
    assert "\n" not in str(fault.value)
    return str(fault.value)


def camera_in(said):
    return re.search(r"camera\.json[^`]*`(\{.*?\})`", said).group(1)


def followed(folder, said):
    """Does what a message asks for: writes the files that it names as its examples have them."""
    if found := re.search(
        r"rgb\.txt, a line for every image, `timestamp file` \(s, increasing\), as `(\S+) (\S+)`", said
    ):
        first = folder / found[2]
        if not first.exists():
            photograph(first.parent)
        files = sorted(first.parent.iterdir())
        images = [file.relative_to(folder) for file in files if file.suffix == ".png"]
        assert str(images[0]) == found[2]
        (folder / "rgb.txt").write_text("".join(f"{float(found[1]) + k:.6f} {name}\n" for k, name in enumerate(images)))
    if "camera.json" in said:
        camera = json.loads(camera_in(said))
        (folder / "camera.json").write_text(json.dumps(camera | {"width": WIDTH, "height": HEIGHT}))
    for name in ("odometry", "depth"):
        if found := re.search(rf"{name}\.txt \([^`]*`[^`]*`, as `([^`]*)`\)", said):
            first, _, rest = found[1].partition(" ")
            assert float(first) == 0
            if name == "odometry":
                times = [line.split()[0] for line in (folder / "rgb.txt").read_text().splitlines()]
                (folder / "odometry.txt").write_text("".join(f"{time} {rest}\n" for time in times))
            else:
                assert rest.startswith("depth/")


def empty(folder):
    pass


def images_inside(folder):
    photograph(folder / "rgb")


def images_without_list(folder):
    photograph(folder)
    (folder / "camera.json").write_text(json.dumps(INTRINSICS))


def only_odometry(folder):
    photograph(folder / "colour")
    photograph(folder / "a_depth")
    (folder / "odometry.txt").write_text("".join(f"{k}.0 0 0 0 0 0 0 1\n" for k in range(COUNT)))


def only_a_list(folder):
    names = photograph(folder / "rgb")
    (folder / "rgb.txt").write_text("".join(f"{k}.0 rgb/{name}\n" for k, name in enumerate(names)))


@pytest.mark.parametrize("begin", [empty, images_inside, images_without_list, only_odometry, only_a_list])
def test_a_folder_runs_once_its_one_message_is_followed(tmp_path, begin):
    begin(tmp_path)
    said = refused(tmp_path)
    assert ("camera.json" in said and "rgb.txt" in said) or begin is only_a_list
    followed(tmp_path, said)
    run = read_sequence(tmp_path)
    assert len(run) == COUNT and run.rgb(0).shape == (HEIGHT, WIDTH, 3)
    assert run.camera.base_from_camera[2, 3] == pytest.approx(0.4)


def test_an_example_has_the_size_and_the_times_of_the_images(tmp_path):
    photograph(tmp_path / "rgb", [f"{1700000000 + k}.500000.png" for k in range(COUNT)])
    said = refused(tmp_path)
    assert "`1700000000.500000 rgb/1700000000.500000.png`" in said
    camera = json.loads(camera_in(said))
    assert (camera["width"], camera["height"]) == (WIDTH, HEIGHT)


def test_a_folder_of_images_asks_for_camera_and_mount_at_once(tmp_path):
    photograph(tmp_path / "walk")
    said = refused(tmp_path / "walk")
    assert said.startswith(f"{tmp_path / 'walk'}: two things are missing: (1) the camera: give --camera FILE")
    file = tmp_path / "camera.json"
    file.write_text(camera_in(said))
    log = open_log(tmp_path / "walk")
    camera, _ = camera_of(log, file)
    words = shlex.split(said.partition("(2)")[2])
    height, pitch = (float(words[words.index(flag) + 1]) for flag in ("--mount.height-m", "--mount.pitch-deg"))
    mounted, _ = camera_of(log, file, MountOptions(height_m=height, pitch_deg=pitch))
    np.testing.assert_allclose(mounted.base_from_camera, camera.base_from_camera, atol=1e-5)
    with pytest.raises(ValueError, match="--camera FILE") as fault:
        camera_of(log, mount=MountOptions(height_m=height, pitch_deg=pitch))
    assert "--mount" not in str(fault.value)


def test_a_video_asks_for_camera_and_mount_at_once(tmp_path):
    path = tmp_path / "walk.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (WIDTH, HEIGHT))
    for k in range(COUNT):
        video.write(np.full((HEIGHT, WIDTH, 3), 40 * k, np.uint8))
    video.release()
    said = refused(path)
    assert "two things are missing: (1) the camera" in said and "(2) the mount" in said and "--mount.height-m" in said
