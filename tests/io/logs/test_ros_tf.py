import numpy as np
import pytest

from ebjax.io.logs.ros_clock import clock
from ebjax.io.logs.ros_mount import BODY_FROM_OPTICAL, mount, movement
from ebjax.io.logs.ros_odometry import odometry_from_tf, trajectory_of_base
from ebjax.io.logs.ros_poses import PoseSamples
from ebjax.io.logs.ros_tf import TfTree

NO_TURN = (1.0, 0.0, 0.0, 0.0)
OPTICAL = (0.5, -0.5, 0.5, -0.5)
TIMES = np.array([1.0, 2.0, 3.0])


def fixed(translation, quaternion=NO_TURN):
    return added(PoseSamples(), 0, translation, quaternion)


def added(samples, time, translation, quaternion=NO_TURN):
    stamp = round(time * 1e9)
    return samples.add(stamp, stamp + 5 * 10**9, tuple(map(float, translation)), tuple(map(float, quaternion)))


def moving(positions, quaternion=NO_TURN):
    samples = PoseSamples()
    for time, x in positions:
        added(samples, time, (x, 0, 0), quaternion)
    return samples


def test_the_chain_goes_up_and_down_and_never_beyond_the_samples():
    static = {("base_link", "camera"): fixed((0.2, 0, 0.5)), ("base_link", "base_footprint"): fixed((0, 0, -0.1))}
    tree = TfTree(static, {("odom", "base_link"): moving([(1, 0), (2, 1), (2.5, 1)])})
    assert tree.base("camera") == "base_footprint"
    assert tree.chain("odom", "camera") == [("odom", "base_link"), ("base_link", "camera")]
    assert tree.chain("odom", "laser") is None and np.isnan(tree.at("odom", "laser", TIMES)).all()
    poses = tree.at("base_footprint", "camera", TIMES)
    np.testing.assert_allclose(poses[:, :3, 3], np.tile([0.2, 0, 0.6], (3, 1)))
    poses = tree.at("camera", "odom", np.array([0.999, 1.0, 1.5, 2.5, 2.501]))
    np.testing.assert_allclose(poses[1:4, 0, 3], [-0.2, -0.7, -1.2])
    assert np.isnan(poses[[0, 4]]).all()
    np.testing.assert_array_equal(tree.times("odom", "camera"), [1, 2, 2.5])


def test_a_moving_transform_beats_a_static_one_and_prefixes_are_seen():
    static = {("map", "odom"): fixed((9, 9, 9)), ("robot1/base_link", "robot1/cam"): fixed((1, 0, 0))}
    tree = TfTree(static, {("map", "odom"): moving([(1, 0), (3, 2)])})
    np.testing.assert_allclose(tree.at("map", "odom", TIMES)[:, 0, 3], [0, 1, 2])
    assert tree.base("robot1/cam") == "robot1/base_link" and tree.base("odom") is None
    by_receipt = TfTree(static, {("map", "odom"): moving([(1, 0), (3, 2)])}, by_receipt=True)
    np.testing.assert_allclose(by_receipt.at("map", "odom", TIMES + 5)[:, 0, 3], [0, 1, 2])


def test_a_static_transform_with_two_values_is_said():
    samples = added(fixed((0, 0, 0)), 0, (1, 0, 0))
    tree = TfTree({("base_link", "camera"): samples}, {})
    assert "camera is given at several places in base_link" in tree.notes[0]
    assert tree.at("base_link", "camera", TIMES)[0, 0, 3] == 1
    broken = fixed((0, 0, 0), (0, 0, 0, 0))
    assert TfTree({("base_link", "camera"): broken}, {}).frames == frozenset()


@pytest.mark.parametrize("frame, quaternion", [("cam_optical", OPTICAL), ("cam", OPTICAL), ("cam", NO_TURN)])
def test_the_mount_is_of_the_optical_frame(frame, quaternion):
    tree = TfTree({("base_link", frame): fixed((0.2, 0, 0.5), quaternion)}, {})
    base_from_camera, base, notes = mount(tree, frame, TIMES)
    expected = BODY_FROM_OPTICAL.copy()
    expected[:3, 3] = 0.2, 0, 0.5
    np.testing.assert_allclose(base_from_camera, expected, atol=1e-12)
    assert base == "base_link" and any("body frame" in note for note in notes) == (quaternion == NO_TURN)


def test_an_optical_name_on_a_body_frame_is_said_and_a_tilted_camera_is_not_turned():
    _, _, notes = mount(TfTree({("base_link", "cam_optical_frame"): fixed((0, 0, 1))}, {}), "cam_optical_frame", TIMES)
    assert any("points up although it is called optical" in note for note in notes)
    down = (0.0, 1.0, 0.0, 0.0)
    base_from_camera, _, notes = mount(TfTree({("base_link", "cam"): fixed((0, 0, 1), down)}, {}), "cam", TIMES)
    assert base_from_camera[2, 2] == -1 and len(notes) == 1


def test_a_camera_that_moves_is_said():
    static, link = {("base_link", "neck"): fixed((0, 0, 0))}, moving([(0.5, 0), (2, 0.015), (3.5, 0.03)], OPTICAL)
    base_from_camera, _, notes = mount(TfTree(static, {("neck", "cam"): link}), "cam", TIMES)
    np.testing.assert_allclose(base_from_camera[0, 3], 0.005)
    assert any("cam moves on base_link by up to 0.020 m" in note for note in notes)
    assert mount(TfTree({}, {}), "cam", TIMES)[0] is None
    base_from_camera, _, notes = mount(TfTree(static, {("neck", "cam"): link}), "cam", TIMES + 9)
    assert base_from_camera is None and "no transform from base_link to cam" in notes[0]


def test_movement_measures_the_turn():
    turn = np.deg2rad(0.5)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    np.testing.assert_allclose(movement(poses), (0, 0.5), atol=1e-9)


def test_odometry_of_another_frame_is_moved_to_the_base():
    samples = moving([(1, 0), (2, 1), (3, 2)])
    tree = TfTree({("base_link", "t265"): fixed((0.5, 0, 0)), ("base_link", "cam"): fixed((1, 0, 0))}, {})
    odometry, notes = trajectory_of_base(samples, ("odom", "t265"), tree, "base_link", name="/pose", by_receipt=False)
    np.testing.assert_allclose(odometry.poses[:, 0, 3], [-0.5, 0.5, 1.5])
    np.testing.assert_allclose(odometry.timestamps, TIMES)
    assert "poses of t265, moved to base_link" in notes[-1]
    odometry, notes = trajectory_of_base(samples, ("odom", "imu"), tree, "base_link", name="/pose", by_receipt=True)
    np.testing.assert_allclose(odometry.timestamps, TIMES + 5)
    assert "'imu' is not joined with base_link in tf; taken as that of base_link" in notes[-1]
    _, notes = trajectory_of_base(samples, ("odom", "base_link"), tree, "base_link", name="/pose", by_receipt=False)
    assert notes == ()


def test_bad_poses_are_left_out():
    samples = added(moving([(1, 0), (2, 1), (2, 7)]), 3, (0, 0, 0), (0, 0, 0, 0))
    added(added(samples, 4, (np.nan, 0, 0)), 0, (0, 0, 0))
    trajectory, notes = samples.trajectory("/odom", False)
    np.testing.assert_array_equal(trajectory.timestamps, [1, 2])
    assert "3 of 6 poses" in notes[0] and "1 poses at times that occur twice" in notes[1]


def test_odometry_of_tf():
    tree = TfTree({}, {("odom", "base_footprint"): moving([(1, 0), (2, 1)])})
    odometry, notes = odometry_from_tf(tree, None, "/tf")
    np.testing.assert_allclose(odometry.poses[:, 0, 3], [0, 1])
    assert "odom to base_footprint, 2 poses" in notes[0]
    assert odometry_from_tf(TfTree({}, {}), None, "/tf") == (None, ())


def test_the_clock():
    stamps = np.array([[5, 100], [6, 101]])
    assert clock("/image", {"/image": stamps, "/odom": stamps + np.array([[1, 0]])}) == (False, ())
    zeros = np.array([[0, 100], [0, 101]])
    by_receipt, notes = clock("/image", {"/image": stamps, "/odom": zeros})
    assert by_receipt and "/odom: its stamps are 0" in notes[0]
    few = np.concatenate([np.array([[0, 99]]), np.stack([np.arange(5, 25), np.arange(100, 120)], 1)])
    assert clock("/image", {"/image": few, "/odom": stamps}) == (False, ())
    by_receipt, notes = clock("/image", {"/image": stamps, "/odom": stamps + np.array([[1000, 0]])})
    assert by_receipt and "another clock" in notes[0]
