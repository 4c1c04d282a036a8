import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from ebjax.geometry.lean_numbers import levels, turned
from ebjax.io.logs.ros_bag import open_bag
from ebjax.io.poses import quaternion_from_rotation

pytest.importorskip("rosbags.highlevel")
sys.path.insert(0, str(Path(__file__).parent))
made = importlib.import_module("bag_writer")


def rotation(roll, pitch, yaw):
    """Of the fixed axes x, y and z, one after the other."""
    about_x, about_y, about_z = (
        turned(k, np.array([float(angle)]))[0, :3, :3] for k, angle in enumerate((roll, pitch, yaw))
    )
    return about_z @ about_y @ about_x


def wxyz(rotation):
    return tuple(map(float, quaternion_from_rotation(rotation[None])[0]))


def nod(stamp):
    """Roll and pitch of the base, rad."""
    t = stamp - 1000
    return np.radians(0.8) * np.sin(4 * t), np.radians(1.2) * np.sin(2.3 * t + 1)


def written(tmp_path, kind="mcap", *, odometry=None, known=True, joined=True, every=0.02, yaw=0.9, offset=(0.0, 0.0)):
    """A run whose IMU is mounted turned, and a little askew by `offset`; its own heading differs from odometry's."""
    mounted = rotation(0, np.pi, 0) @ rotation(0, 0, 0.4)
    with made.BagWriter(tmp_path, kind) as bag:
        made.write_run(bag)
        if joined:
            bag.tf(1000, ("base_link", "imu_link", (0.1, 0, 0.2), wxyz(mounted)), static=True)
        for stamp in np.arange(999.9, 1002.2, every):
            roll, pitch = nod(stamp)
            at = rotation(roll + offset[0], pitch + offset[1], yaw) @ mounted
            bag.imu("/imu/data", stamp, wxyz(at), known=known)
            bag.imu("/camera/imu", stamp, (1.0, 0, 0, 0), known=False)
        for stamp in odometry or ():
            bag.odometry("/odom", stamp, (0, 0, 0), quaternion=(np.cos(0.01), 0, np.sin(0.01) * (stamp % 1), 0))
    return open_bag(bag.path)


def said(log, *words):
    return any(all(word in note for word in words) for note in log.notes)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.02, -0.03)])
def test_odometry_takes_the_roll_and_pitch_of_an_imu(tmp_path, kind, offset):
    log = written(tmp_path, kind, offset=offset)
    assert said(log, "roll and pitch from /imu/data") and said(log, "/imu/data of ", "odometry has its roll and pitch")
    expected = np.array([nod(stamp) for stamp in log.odometry.timestamps])
    if any(offset):
        expected = expected - np.median(expected, axis=0)
    level = levels(log.odometry.poses[:, 2, :3])
    found = np.stack([np.arctan2(level[:, 2, 1], level[:, 2, 2]), -np.arcsin(level[:, 2, 0])], 1)
    atol = 3e-5 if not any(offset) else 1e-3
    np.testing.assert_allclose(found - np.median(found, 0), expected - np.median(expected, 0), atol=atol)
    np.testing.assert_allclose(np.arctan2(log.odometry.poses[:, 1, 0], log.odometry.poses[:, 0, 0]), 0, atol=1e-12)
    np.testing.assert_allclose(log.odometry.poses[:, 0, 3], np.arange(len(level)) / 4)


@pytest.mark.parametrize(
    "options, words",
    [
        ({"known": False}, "without orientation"),
        ({"joined": False}, "its frame 'imu_link' is not joined with base_link"),
        ({"every": 0.5}, "lie between two samples at most 0.2 s apart"),
    ],
)
def test_an_imu_that_says_nothing_is_named(tmp_path, options, words):
    log = written(tmp_path, **options)
    assert said(log, "/imu/data", words)
    np.testing.assert_array_equal(log.odometry.poses[:, 2, :3], np.tile([0.0, 0, 1], (len(log.odometry.poses), 1)))


def test_the_topic_can_be_named(tmp_path):
    path = written(tmp_path).path
    log = open_bag(path, topics={"imu": "/camera/imu"})
    assert said(log, "roll and pitch from /camera/imu", "others are /imu/data")
    with pytest.raises(
        ValueError, match="/nothing, given as imu, has no messages of sensor_msgs/Imu; such topics are:"
    ):
        open_bag(path, topics={"imu": "/nothing"})


def test_odometry_that_leans_itself_is_kept(tmp_path):
    with made.BagWriter(tmp_path, "mcap") as bag:
        made.write_run(bag)
        for stamp in np.arange(1000, 1001.6, 0.05):
            bag.odometry("/odom3d", stamp, (0, 0, 0), quaternion=(np.cos(stamp % 1), 0, np.sin(stamp % 1), 0))
            bag.imu("/imu", stamp, (1.0, 0, 0, 0), frame="base_link")
    log = open_bag(bag.path, topics={"odometry": "/odom3d"})
    assert said(log, "/imu of ", "not used, as odometry has roll and pitch itself")
    log = open_bag(bag.path)
    assert said(log, "/imu of ", "not used, as its roll and pitch never change")
