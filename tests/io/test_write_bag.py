import builtins

import cv2
import numpy as np
import pytest

from ebjax.io.camera_file import CameraFile
from ebjax.io.logs.open import LogOptions, Topics, open_log
from ebjax.io.poses import poses_from, rotation_from_quaternion
from ebjax.io.write_bag import write_bag
from ebjax.io.write_sequence import write_sequence

K = np.array([[50.0, 0.0, 15.7], [0.0, 49.5, 11.2], [0.0, 0.0, 1.0]])
LENSES = {
    "pinhole": (),
    "plumb_bob": (0.15, -0.3, 0.0008, -0.0006, 0.16),
    "equidistant": (0.045, 0.012, -0.02, 0.006),
}
N = 6


def camera(model="equidistant", depth_scale=1000.0):
    mount = np.eye(4)
    mount[:3, :3] = [[0, -0.6, 0.8], [-1, 0, 0], [0, -0.8, -0.6]]
    mount[:3, 3] = 0.25, 0.01, 0.9
    return CameraFile(K, mount, 32, 24, depth_scale, model, LENSES[model])


def frame(i):
    across = np.linspace(0, 60, 32, dtype=np.float32)[None].repeat(24, 0)
    rgb = np.stack([20.0 * i + across, 40 + across, np.full((24, 32), 200.0)], axis=2).astype(np.uint8)
    depth = np.full((24, 32), 1000 + i, np.uint16)
    depth[0] = 0
    return rgb, depth


def write_run(folder, camera):
    stamps = 1700000000.25 + 0.1 * np.arange(N)
    quaternions = np.random.default_rng(0).normal(size=(2, N, 4)) * [0.05, 0.05, 0.05, 0.6] + [1.0, 0, 0, 0]
    moves = np.random.default_rng(1).normal(size=(2, N, 3))
    odometry, truth = (poses_from(rotation_from_quaternion(q), t) for q, t in zip(quaternions, moves, strict=True))
    write_sequence(folder, stamps, odometry, truth, camera, frame)
    return stamps, odometry, truth


@pytest.mark.parametrize("kind, name", [("bag", "ROS 1 bag"), ("mcap", "ROS 2 bag (mcap)")])
@pytest.mark.parametrize("model", LENSES)
def test_a_bag_reads_back_as_the_run(tmp_path, kind, name, model):
    expected = camera(model)
    stamps, odometry, truth = write_run(tmp_path / "run", expected)
    path = tmp_path / "run" / f"run.{kind}"
    write_bag(path, tmp_path / "run", kind)
    log = open_log(path, LogOptions(topics=Topics(truth="/ground_truth")))
    tum = open_log(tmp_path / "run")
    assert log.kind == name and not log.missing and len(log.colour) == len(log.depth) == N
    np.testing.assert_allclose(log.colour.timestamps, stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(log.depth.timestamps, stamps, rtol=0, atol=1e-6)
    for i in range(N):
        assert np.all(log.colour.decode(i) == tum.colour.decode(i)), "the same JPEG"
        np.testing.assert_allclose(log.depth.decode(i), tum.depth.decode(i), rtol=1e-6)
    for found, poses in ((log.odometry, odometry), (log.truth, truth)):
        np.testing.assert_allclose(found.timestamps, stamps, rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.poses, poses, atol=1e-6)
    np.testing.assert_allclose(log.camera.intrinsics, K, atol=1e-12)
    np.testing.assert_allclose(log.camera.base_from_camera, expected.base_from_camera, atol=1e-6)
    assert (log.camera.width, log.camera.height) == (32, 24)
    assert (log.camera.distortion_model, log.camera.distortion) == (model, LENSES[model])
    assert not [child for child in path.parent.iterdir() if "partial" in child.name]


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_the_images_bytes_are_the_files(tmp_path, kind):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    write_run(tmp_path / "run", camera())
    write_bag(tmp_path / f"other.{kind}", tmp_path / "run", kind)
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
    images, info, tf = [], set(), {}
    with AnyReader([tmp_path / f"other.{kind}"], default_typestore=store) as reader:
        topics = {c.topic: c for c in reader.connections}
        for connection, received, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            header = (message.transforms[0] if "tf" in connection.topic else message).header
            assert header.stamp.sec * 10**9 + header.stamp.nanosec == received
            if connection.topic == "/camera/image_raw/compressed":
                images.append(bytes(message.data))
            elif connection.topic == "/camera/camera_info":
                info.add((message.distortion_model, header.frame_id))
            elif "tf" in connection.topic:
                tf[connection.topic] = header.frame_id, message.transforms[0].child_frame_id
    assert images == [file.read_bytes() for file in sorted((tmp_path / "run" / "rgb").iterdir())]
    assert info == {("equidistant", "camera_optical_frame")}
    assert tf == {"/tf": ("odom", "base_link"), "/tf_static": ("base_link", "camera_optical_frame")}
    static = topics["/tf_static"].ext
    assert static.latching == 1 if kind == "bag" else static.offered_qos_profiles[0].durability.value == 1


def test_what_a_bag_cannot_hold_is_refused_and_nothing_is_left(tmp_path):
    write_run(tmp_path / "run", camera(depth_scale=5000.0))
    with pytest.raises(ValueError, match=r"camera\.json: 'depth_scale' is 5000\.0.*millimetres"):
        write_bag(tmp_path / "a.bag", tmp_path / "run", "bag")
    write_run(tmp_path / "other", camera())
    (tmp_path / "other" / "rgb.txt").write_text("1700000000.25 rgb/a.bmp\n")
    assert cv2.imwrite(str(tmp_path / "other" / "rgb" / "a.bmp"), np.zeros((24, 32), np.uint8))
    with pytest.raises(ValueError, match=r"a\.bmp: a bag has images as JPEG or PNG"):
        write_bag(tmp_path / "a.mcap", tmp_path / "other", "mcap")
    (tmp_path / "other" / "camera.json").unlink()
    with pytest.raises(ValueError, match=r"camera\.json"):
        write_bag(tmp_path / "a.bag", tmp_path / "other", "bag")
    assert sorted(child.name for child in tmp_path.iterdir()) == ["other", "run"]


def test_a_missing_rosbags_says_how_to_get_it(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *arguments, **options):
        if name.partition(".")[0] == "rosbags":
            raise ModuleNotFoundError("No module named 'rosbags'", name="rosbags")
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ValueError, match=r'needs rosbags: pip install "ebjax\[bags\]"'):
        write_bag(tmp_path / "a.bag", tmp_path, "bag")
