import importlib
import json
import shutil
import struct
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from ebjax.io.images import BrokenFrame
from ebjax.io.logs.ros_bag import bag_contents, open_bag

pytest.importorskip("rosbags.highlevel")
pytest.importorskip("rosbags.image")
sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("bag_writer")
BagWriter, KINDS, picture, write_run = made.BagWriter, made.KINDS, made.picture, made.write_run
NO_TURN = (1, 0, 0, 0)
MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])


def written(tmp_path, kind, fill=write_run, **options):
    with BagWriter(tmp_path, kind) as bag:
        fill(bag, **options)
    return bag.path


def said(log, *words):
    return any(all(word in note for word in words) for note in log.notes)


def check_run(log, count=8):
    assert len(log.colour) == len(log.depth) == count and log.missing == {}
    np.testing.assert_allclose(log.colour.timestamps, 1000 + 0.2 * np.arange(count), rtol=0, atol=1e-6)
    for k in (count - 1, 0, count // 2, *range(count)):
        np.testing.assert_array_equal(log.colour.decode(k), picture(k))
        np.testing.assert_allclose(log.depth.decode(k)[1:], (1000 + k) / 1000, rtol=1e-6)
        assert not log.depth.decode(k)[0].any() and log.depth.decode(k).dtype == np.float32
    np.testing.assert_allclose(log.odometry.timestamps, 1000 + 0.05 * np.arange(4 * count), rtol=0, atol=1e-6)
    np.testing.assert_allclose(log.odometry.poses[:, 0, 3], np.arange(4 * count) / 4)
    assert (log.camera.width, log.camera.height) == (32, 24) and log.camera.distortion_model == "pinhole"
    np.testing.assert_array_equal(log.camera.intrinsics.ravel(), made.K)
    np.testing.assert_allclose(log.camera.base_from_camera, MOUNT, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_reads_alike(tmp_path, kind):
    log = open_bag(written(tmp_path, kind))
    check_run(log)
    assert "/camera/color/image_raw  sensor_msgs/Image  8 messages" in log.contents
    assert said(log, "images from /camera/color/image_raw, 8 messages") and said(log, "mount is camera_optical")


@pytest.mark.parametrize("kind", ["sqlite3", "mcap", "mcap-file"])
def test_a_folder_without_metadata_and_a_lone_file(tmp_path, kind):
    folder = written(tmp_path, kind)
    (folder / "metadata.yaml").unlink()
    check_run(open_bag(folder))
    check_run(open_bag(next(folder.iterdir())))


def test_splits_are_joined(tmp_path):
    folder = tmp_path / "splits"
    folder.mkdir()
    for number, (start, name) in enumerate([(1000.0, "a"), (1001.6, "b")]):
        with BagWriter(tmp_path, "sqlite3", name) as bag:
            write_run(bag, start=start)
        shutil.copy(bag.path / f"{name}.db3", folder / f"run_{9 + number}.db3")
    log = open_bag(folder)
    assert len(log.colour) == 16 and log.colour.decode(15).shape == (24, 32, 3)


@pytest.mark.parametrize("kind, share", [("ros1", 0.7), ("ros1-lz4", 0.5), ("mcap", 0.7), ("mcap-storage", 0.5)])
def test_a_cut_bag_is_read_up_to_the_cut(tmp_path, kind, share):
    path = written(tmp_path, kind, count=300)
    path = path if path.is_file() else path / "run.mcap"
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    log = open_bag(path)
    assert 20 < len(log.colour) < 300 and said(log, "cut off") and "mount" in log.missing
    for k in (0, len(log.colour) - 1):
        np.testing.assert_array_equal(log.colour.decode(k), picture(k))


def test_a_bag_of_a_killed_recorder(tmp_path):
    """No index at the end, and no connections there: the header's index position stays 0."""
    path = written(tmp_path, "ros1")
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"op=\x05") - 100].ljust(0))
    with pytest.raises(ValueError, match=r"run\.bag: the bag has no messages"):
        open_bag(path)
    end = content.index(b"op=\x04")
    path.write_bytes(content[: end - 8])
    check_run(open_bag(path))


def test_chosen_topics_and_wrong_ones(tmp_path):
    def fill(bag):
        write_run(bag, count=3)
        for k in range(5):
            bag.raw("/left/image_raw", 1000 + k, picture(k), "rgb8")
            bag.odometry("/wheel/odometry", 1000 + k, (7, k, 0))
            bag.pose_stamped("/ground_truth", 1000 + k, (k, 0, 0))

    path = written(tmp_path, "mcap", fill)
    log = open_bag(path)
    assert len(log.colour) == 3 and log.odometry.poses[0, 0, 3] == 0 and log.truth is None
    assert said(log, "images from /camera/color/image_raw", "others are /left/image_raw")
    assert said(log, "odometry from /odom", "others are /wheel/odometry")
    assert said(log, "no truth is read; --topics.truth /ground_truth reads it from there")
    log = open_bag(path, topics={"image": "left/image_raw", "odometry": "/wheel/odometry", "truth": "/ground_truth"})
    assert len(log.colour) == 5 and log.odometry.poses[2, 1, 3] == 2 and log.truth.poses[4, 0, 3] == 4
    assert log.camera.source.startswith("/camera/color/camera_info of ")
    with pytest.raises(ValueError, match=r"/nowhere, given as image, .* such topics are: /camera/color/image_raw"):
        open_bag(path, topics={"image": "/nowhere"})
    with pytest.raises(ValueError, match="'colour' is no role"):
        open_bag(path, topics={"colour": "/left/image_raw"})


def test_stamps_of_zero_mean_receipt_for_everything(tmp_path):
    def fill(bag):
        for k in range(5):
            bag.raw("image", 0, picture(k), "rgb8", received=50 + k)
            bag.odometry("/odom", 2000 + k, (k, 0, 0), received=50 + k + 0.25)

    log = open_bag(written(tmp_path, "ros1", fill))
    np.testing.assert_allclose(log.colour.timestamps, 50 + np.arange(5), atol=1e-6)
    np.testing.assert_allclose(log.odometry.timestamps, 50.25 + np.arange(5), atol=1e-6)
    assert said(log, "/image: its stamps are 0", "receipt") and log.colour.names[1] == "/image 51.000000"


def test_two_clocks_mean_receipt_for_everything(tmp_path):
    def fill(bag):
        for k in range(5):
            bag.raw("/image", 7 + k, picture(k), "rgb8", received=9000 + k)
            bag.odometry("/odom", 9000 + k, (k, 0, 0), received=9000 + k)

    log = open_bag(written(tmp_path, "mcap", fill))
    np.testing.assert_allclose(log.colour.timestamps, 9000 + np.arange(5), atol=1e-6)
    assert said(log, "/odom: its stamps are of another clock")


def test_unsorted_and_repeated_images(tmp_path):
    def fill(bag):
        for k, time in enumerate([3, 1, 2, 2, 5]):
            bag.raw("/image", time, picture(k), "rgb8", received=100 + k)
            bag.odometry("/odom", time, (k, 0, 0), received=100 + k)

    log = open_bag(written(tmp_path, "sqlite3", fill))
    np.testing.assert_allclose(log.colour.timestamps, [1, 2, 3, 5])
    np.testing.assert_allclose(log.odometry.timestamps, [1, 2, 3, 5])
    np.testing.assert_array_equal(log.colour.decode(2), picture(0))
    assert said(log, "/image", "sorted") and said(log, "/image: 1 images at times that occur twice")


def test_raw_is_preferred_to_compressed_and_broken_frames_are_named(tmp_path):
    def fill(bag):
        for k in range(4):
            content = made.jpeg(picture(k))
            bag.compressed("/a/image/compressed", 10 + k, content[: 200 if k == 2 else None], "jpeg")
            if k < 2:
                bag.raw("/b/image", 10 + k, picture(k), "rgb8")
                bag.compressed("/b/image/compressed", 10 + k, content, "rgb8; jpeg compressed bgr8")

    path = written(tmp_path, "ros1", fill)
    log = open_bag(path)
    assert said(log, "images from /a/image/compressed")
    assert np.abs(log.colour.decode(1) - picture(1).astype(int)).max() < 9
    with pytest.raises(BrokenFrame, match=r"run\.bag: /a/image/compressed 12\.000000: truncated JPEG"):
        log.colour.decode(2)
    log = open_bag(path, topics={"image": "/b/image"})
    np.testing.assert_array_equal(log.colour.decode(1), picture(1))


def test_odometry_comes_from_tf_where_no_topic_has_it(tmp_path):
    def fill(bag):
        for k in range(5):
            bag.raw("/image", 10 + k, picture(k), "rgb8", frame="cam_optical")
            bag.tf(10 + k, ("odom", "base_footprint", (k, 0, 0), NO_TURN), ("map", "odom", (9, 9, 0), NO_TURN))
            bag.tf(10.5 + k, ("wheel", "cog", (0, 0, 0), NO_TURN), kind="tf/msg/tfMessage")
        bag.tf(10, ("base_footprint", "base_link", (0, 0, 0.1), NO_TURN), static=True)
        bag.tf(10, ("base_link", "cam_optical", (0, 0, 0.5), made.OPTICAL), static=True)

    log = open_bag(written(tmp_path, "ros1", fill))
    np.testing.assert_allclose(log.odometry.poses[:, 0, 3], np.arange(5))
    assert said(log, "odometry from tf, odom to base_footprint, 5 poses") and "odometry" not in log.missing
    assert log.base_from_camera[2, 3] == pytest.approx(0.6) and set(log.missing) == {"camera", "depth"}


def test_bags_without_images(tmp_path):
    def fill(bag):
        bag.odometry("/odom", 1, (0, 0, 0))

    path = written(tmp_path, "mcap", fill)
    with pytest.raises(ValueError, match=r"run: no topic has images .*Topics: /odom  nav_msgs/Odometry  1 messages"):
        open_bag(path)
    assert bag_contents(path) == ("/odom  nav_msgs/Odometry  1 messages",)
    with pytest.raises(ValueError, match="the bag has no messages"):
        open_bag(written(tmp_path, "ros1", lambda bag: None))


def test_wrong_files(tmp_path):
    (tmp_path / "notes.bag").write_text("#ROSBAG V1.2\n")
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    cases = {"notes.bag": "rosbag migrate", "empty.mcap": "is empty", "folder": "no bag", "absent": "no such file"}
    for name, words in cases.items():
        with pytest.raises(ValueError, match=rf"{name}: .*{words}"):
            open_bag(tmp_path / name)
    (tmp_path / "damaged.bag").write_bytes(
        b"#ROSBAG V2.0\n" + struct.pack("<I4sBI", 9, struct.pack("<I", 5), 111, 0) * 9
    )
    with pytest.raises(ValueError, match=r"damaged\.bag: "):
        open_bag(tmp_path / "damaged.bag")
    (tmp_path / "text.db3").write_text(json.dumps({}))
    with pytest.raises(ValueError, match=r"text\.db3: not a ROS bag; give a ROS 1"):
        open_bag(tmp_path / "text.db3")


REAL = {
    "ros1_foxglove_example_bz2.bag": (9, 8647, None),
    "ros1_foxglove_example_lz4.bag": (9, 8647, None),
    "ros1_ros_numpy_image.bag": (9, 9, (2, 2)),
    "ros1_truncated.bag": (1, 3, None),
    "ros1_ubiquity_aruco_images.bag": (2, 16, (1280, 960)),
    "ros1_ubiquity_board_611.bag": (2, 33, (1280, 720)),
    "ros1_unindexed.bag": (2, 14, None),
    "ros2_amber_soccer_goal_12.mcap": (1, 2, (640, 480)),
    "ros2_camera_topics_zero_messages": (4, 0, None),
    "ros2_klintan_sample.db3": (5, 5, (640, 480)),
    "ros2_neato_person_follower": (9, 1840, None),
    "ros2_tiryoh_sample.mcap": (2, 14, None),
    "ros2_truncated.mcap": (2, 14, None),
}


@pytest.mark.parametrize("name", REAL)
def test_real_bags(data, name):
    path, (topics, messages, size) = data("logs/bags") / name, REAL[name]
    contents = bag_contents(path)
    assert len(contents) == topics and sum(int(line.split()[-2]) for line in contents) == messages
    if size is None:
        with pytest.raises(ValueError, match=rf"{name}: .*(no topic has images|no messages).*Topics: /"):
            open_bag(path)
        return
    log = open_bag(path)
    for k in range(len(log.colour)):
        assert log.colour.decode(k).shape == (size[1], size[0], 3)
    assert (log.camera is None) == ("ubiquity" not in name) and "mount" in log.missing


def test_a_packed_file_that_is_no_bag(tmp_path):
    zstd = pytest.importorskip("backports.zstd")
    (tmp_path / "run.mcap.zstd").write_bytes(zstd.compress(b"text"))
    with pytest.raises(ValueError, match=r"run\.mcap\.zstd: not a ROS bag"):
        open_bag(tmp_path / "run.mcap.zstd")
    (tmp_path / "run.mcap.zstd").write_bytes(zstd.compress(b"text" * 9)[:-3])
    with pytest.raises(ValueError, match=r"run\.mcap\.zstd: damaged zstd file"):
        open_bag(tmp_path / "run.mcap.zstd")


def test_counts_agree_with_rosbags(data):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    for name in ("ros1_foxglove_example_bz2.bag", "ros2_neato_person_follower", "ros2_tiryoh_sample.mcap"):
        path = data("logs/bags") / name
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            assert len(bag_contents(path)) == len({(c.topic, c.msgtype) for c in reader.connections})
            assert sum(int(line.split()[-2]) for line in bag_contents(path)) == reader.message_count


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("bits", [10, 12])
def test_grey_of_more_than_eight_bits_is_scaled_alike_in_all_images(tmp_path, packed, bits):
    def grey(k):
        ramp = np.linspace(0, (2**bits - 1) * (0.2 if k % 2 else 1.0), 24 * 32).astype(np.uint16)
        return ramp.reshape(24, 32)

    def fill(bag):
        for k in range(6):
            if packed:
                data = cv2.imencode(".png", grey(k))[1].tobytes()
                bag.compressed("/grey/compressed", 1000 + k, data, "mono16; png compressed ")
            else:
                bag.raw("/grey", 1000 + k, grey(k), "mono16")

    log = open_bag(written(tmp_path, "mcap", fill))
    assert said(log, f"of which {bits} are in use")
    for k in range(6):
        np.testing.assert_array_equal(log.colour.decode(k)[..., 0], grey(k) >> (bits - 8))
