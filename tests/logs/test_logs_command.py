"""The command on small logs and on the real ones: right figures, or one clear line."""

import json
import subprocess
import sys

import pytest

from ebjax.command import run
from ebjax.logs.__main__ import Config, main


def listed(capsys, log, *flags):
    run(main, Config, [str(log), *map(str, flags)], needs_jax=False)
    captured = capsys.readouterr()
    assert not captured.err
    return captured.out


def facts(capsys, log, *flags):
    return json.loads(listed(capsys, log, "--json", *flags))


def refused(capsys, log, *flags):
    """What is printed of a log that is refused, and its one error line."""
    with pytest.raises(SystemExit) as stop:
        run(main, Config, [str(log), *map(str, flags)], needs_jax=False)
    assert stop.value.code == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    return captured.out, captured.err


def test_a_bag_in_lines(capsys, bag):
    out = listed(capsys, bag)
    assert out.splitlines()[0] == f"{bag}: ROS 1 bag"
    rows = {line.split()[0]: line for line in out.splitlines() if not line.startswith(" ")}
    assert "8, 32x24, from 1000.000 s, 1.4 s long, 5/s, largest gap 0.2 s (/camera/color/image_raw)" in rows["images"]
    assert "all images have one" in rows["depth"] and "/camera/depth/image_raw" in rows["depth"]
    assert "32x24" in rows["camera"] and "deg" in rows["camera"]
    assert "height 0.500 m, pitch 0.0" in rows["mount"] and "x 0.200" in rows["mount"]
    assert "32, from 1000.000 s, 1.55 s long, 20/s" in rows["odometry"] and "7.8 m driven" in rows["odometry"]
    assert "/camera/depth/image_raw" in out.partition("contents")[2]
    assert out.splitlines()[-1] == f"nothing is missing: python -m ebjax.slam {bag}"


def test_the_same_as_json(capsys, bag):
    found = facts(capsys, bag)
    assert found["images"]["count"] == found["depth"]["paired"] == found["odometry"]["covered"] == 8
    assert found["odometry"]["clock_ahead_s"] is None
    assert found["mount"]["height_m"] == pytest.approx(0.5)
    assert found["missing"] == {} and found["ready"]


def test_says_what_is_missing_and_how_to_give_it(capsys, folder, data):
    (folder / "camera.json").rename(folder.parent / "camera.json")
    (folder / "odometry.txt").unlink()
    out = listed(capsys, folder)
    assert "missing   camera: there is no camera.json" in out
    assert "          mount: measure and give --mount.height-m" in out
    assert "          odometry: there is no odometry.txt" in out
    assert "ebjax.slam" not in out
    given = ["--camera", folder.parent / "camera.json", "--mount.pitch-deg", 20]
    out = listed(capsys, folder, *given)
    assert "camera: " not in out.partition("missing")[2] and "pitch 20.0" in out
    assert out.splitlines()[-1].startswith("it runs without: python -m ebjax.slam")
    assert out.splitlines()[-1].endswith(f"--camera {folder.parent / 'camera.json'} --mount.pitch-deg 20.0")


def test_clocks_apart_and_gaps(capsys, folder):
    lines = (folder / "odometry.txt").read_text().splitlines()
    later = [f"{float(line.split()[0]) + 500:.6f} {line.partition(' ')[2]}" for line in lines if line[0] != "#"]
    (folder / "odometry.txt").write_text("\n".join(later[:3] + later[5:]) + "\n")
    out = listed(capsys, folder)
    assert "0 of 6 images have a pose: its clock starts 500 s after the images'" in out
    assert "largest gap 0.6 s" in out
    assert "not ready odometry.txt: 0 of 6 frames have an odometry pose" in out


def test_images_that_cannot_be_decoded(capsys, folder):
    files = sorted((folder / "rgb").iterdir())
    files[0].write_bytes(files[0].read_bytes()[:100])
    assert "6, 32x24" in (out := listed(capsys, folder)) and "broken: rgb/100.000000.jpg: truncated JPEG" in out
    for file in files:
        file.write_bytes(b"no image")
    assert "rgb.txt: none of 6 images looked at can be read; first " in refused(capsys, folder)[1]


def test_a_bag_without_images_lists_its_topics(capsys, bags, tmp_path):
    with bags.BagWriter(tmp_path, "mcap") as writer:
        writer.odometry("/odom", 1.0, (0.0, 0.0, 0.0))
    out, error = refused(capsys, writer.path)
    assert "ROS 2 bag" in out and "messages  1, from 1.000 s" in out and "/odom  nav_msgs/Odometry  1 messages" in out
    assert "no topic has images" in error and "/odom" not in error
    assert "no topic has images" in json.loads(refused(capsys, writer.path, "--json")[0])["refused"]


@pytest.mark.parametrize("name", ["run.bag", "run.db", "run.db3", "run.mcap", "run.mp4"])
def test_an_empty_file_is_one_line(capsys, tmp_path, name):
    (tmp_path / name).touch()
    out, error = refused(capsys, tmp_path / name)
    assert not out and name in error


REAL = {
    "bags/ros1_ros_numpy_image.bag": (1, 2, 2, None),
    "bags/ros1_ubiquity_aruco_images.bag": (1, 1280, 960, "plumb_bob"),
    "bags/ros1_ubiquity_board_611.bag": (1, 1280, 720, "plumb_bob"),
    "bags/ros2_klintan_sample.db3": (1, 640, 480, None),
    "bags/ros2_amber_soccer_goal_12.mcap": (2, 640, 480, None),
    "rtabmap/corridor_v0.23.8_86_nodes.db": (86, 640, 480, "pinhole"),
    "rtabmap/v0.21.1_one_node_realsense.db": (1, 1280, 720, "pinhole"),
    "rtabmap/v0.17.3_one_node_gazebo.db": (1, 640, 480, "pinhole"),
    "phone_corridors/f04_hallway_main": (45, 1280, 720, None),
    "phone_corridors/f09_hallway_main": (41, 1280, 720, None),
    "robot_video/carpet_320x240.avi": (1631, 320, 240, None),
}
TOPICS_ONLY = {
    "bags/ros1_foxglove_example_bz2.bag": (8647, ""),
    "bags/ros1_foxglove_example_lz4.bag": (8647, ""),
    "bags/ros1_unindexed.bag": (14, "cut off or its recorder was killed"),
    "bags/ros1_truncated.bag": (3, "cut off or its recorder was killed"),
    "bags/ros2_truncated.mcap": (14, "cut off or its recorder was killed"),
    "bags/ros2_tiryoh_sample.mcap": (14, ""),
    "bags/ros2_neato_person_follower": (1840, ""),
    "bags/ros2_camera_topics_zero_messages": (0, ""),
}


@pytest.mark.parametrize("name", REAL)
def test_real_logs(capsys, data, name):
    found, (count, width, height, lens) = facts(capsys, data("logs") / name), REAL[name]
    images = found["images"]
    assert (images["count"], images["width"], images["height"]) == (count, width, height)
    assert (found["camera"] and found["camera"]["distortion_model"]) == lens
    if found["camera"] is not None:
        assert (found["camera"]["width"], found["camera"]["height"]) == (width, height)
    assert ("camera" in found["missing"]) == (lens is None)


@pytest.mark.parametrize("name", TOPICS_ONLY)
def test_real_bags_without_images(capsys, data, name):
    out, error = refused(capsys, data("logs") / name)
    count, note = TOPICS_ONLY[name]
    assert f"messages  {count}" in out and note in out and "contents  /" in out
    assert ("no topic has images" if count else "no messages") in error


def test_a_real_database_without_nodes(capsys, data):
    out, error = refused(capsys, data("logs") / "rtabmap" / "v0.11.13_empty.db")
    assert not out and "no nodes" in error


def test_the_real_corridor_lacks_nothing(capsys, data):
    found = facts(capsys, data("corridor_rgbd"))
    assert found["images"]["count"] == found["depth"]["paired"] == found["truth"]["covered"] == 172
    assert found["odometry"]["distance_m"] == pytest.approx(35.8, abs=0.1)
    assert found["camera"]["field_of_view_deg"] == pytest.approx([55.0, 42.6], abs=0.1)
    assert found["mount"]["pitch_deg"] == pytest.approx(19.0, abs=0.01)
    assert found["ready"] and not found["missing"]


def test_loads_no_jax(folder):
    code = (
        "import sys\nsys.argv = ['x', sys.argv[1]]\nfrom ebjax.command import run\nfrom ebjax.logs.__main__ import *\n"
    )
    code += "run(main, Config, needs_jax=False)\nassert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, stdout=subprocess.DEVNULL)
