"""Files of poses with other columns, frames and headings than world_from_base, made from a robot's path."""

import dataclasses

import numpy as np
import pytest

from ebjax.io.pose_readings import HALF_TURN, OPTICAL, Y_UP
from ebjax.io.poses import invert, poses_from, quaternion_from_rotation, rotation_from_quaternion
from ebjax.io.trajectory import Trajectory, read, read_tum
from ebjax.io.upright import floor_trajectory


def turn(axis, angle):
    """Rotations about x, y or z (0, 1, 2)."""
    quaternion = np.zeros((len(angle), 4))
    quaternion[:, 0], quaternion[:, 1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return rotation_from_quaternion(quaternion)


def world_from_base(x, y, heading, *, z=0.0, pitch=0.0, roll=0.0):
    zero = np.zeros(len(x))
    rotation = turn(2, heading + zero) @ turn(1, pitch + zero) @ turn(0, roll + zero)
    return poses_from(rotation, np.stack([x, y, z + zero], axis=1))


def driven(speed, turn_rate, start=0.0, dt=0.1):
    """Poses of a robot that drives along its x axis."""
    heading = start + np.concatenate([[0], np.cumsum(turn_rate * dt)])
    step = np.concatenate([[0], speed * dt])
    return np.cumsum(step * np.cos(heading)), np.cumsum(step * np.sin(heading)), heading


def frame(rotation, place=(0, 0, 0)):
    return poses_from(np.asarray(rotation)[None], np.asarray(place, float)[None])[0]


def pitched(degrees):
    """A camera at (0.27, 0, 0.54) that looks ahead and down; base_from_camera."""
    return frame(turn(1, np.radians([degrees]))[0] @ OPTICAL, (0.27, 0, 0.54))


N = 600
TIME = np.arange(N) * 0.1
HALF = np.where(np.arange(N) < N // 2, 1.0, -1.0)
SPOT = np.where((np.arange(N) >= 290) & (np.arange(N) < 310), np.pi / 2, 0.0)
WAVES = driven(np.full(N, 0.5), 0.3 * np.sin(TIME / 2.5))
ALONG = 0.5 * np.concatenate([[0], TIME])
CAMERA = pitched(19)
BODY = frame(CAMERA[:3, :3] @ OPTICAL.T, CAMERA[:3, 3])
OUT_AND_BACK = world_from_base(*driven(np.where(SPOT > 0, 0.0, 0.5), SPOT))
U_TURN = world_from_base(*driven(np.full(N, 0.5), np.where((TIME > 26) & (TIME < 34), np.pi / 8, 0.01 * np.sin(TIME))))
WAVE = world_from_base(*WAVES)
PATHS = {"out and back": OUT_AND_BACK, "U-turn": U_TURN, "waves": WAVE}


def trajectory(poses):
    return Trajectory(1000 + np.arange(len(poses)) * 0.1, poses, "run/odometry.txt")


def w_first(poses):
    """What is read of a file whose columns are qw qx qy qz."""
    return poses_from(
        rotation_from_quaternion(quaternion_from_rotation(poses[:, :3, :3])[:, [3, 0, 1, 2]]), poses[:, :3, 3]
    )


def headed(poses, scale):
    x, y, z = poses[:, :3, 3].T
    return world_from_base(x, y, scale * np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0])), z=z)


def motion(poses):
    return np.linalg.inv(poses[0]) @ poses


NOISE = np.random.default_rng(0)
GOOD = PATHS | {
    "circle": world_from_base(*driven(np.full(N, 0.5), np.full(N, 0.3))),
    "reversing": world_from_base(*driven(np.full(N, -0.5), 0.2 * np.sin(TIME / 2))),
    "out and reversing": world_from_base(*driven(0.5 * HALF, 0.1 * np.sin(TIME / 2))),
    "about half a turn": world_from_base(*driven(np.full(N, 0.5), 0.02 * np.sin(TIME), np.pi)),
    "quadruped": world_from_base(
        *WAVES,
        z=0.02 * np.sin(3 * ALONG),
        pitch=np.radians(5) * np.sin(7 * ALONG),
        roll=np.radians(5) * np.sin(9 * ALONG),
    ),
    "ramp": world_from_base(*WAVES, z=np.tan(np.radians(15)) * ALONG, pitch=-np.radians(15)),
    "ramp, pitch not measured": world_from_base(*WAVES, z=np.tan(np.radians(15)) * ALONG),
    "crooked IMU": world_from_base(*driven(np.full(N, 0.5), 0.002 * np.sin(TIME)), roll=np.radians(3)),
    "sideways too": world_from_base(0.5 * TIME, np.sin(TIME / 5), np.zeros(N)),
    "always turning": world_from_base(0.5 * TIME, np.zeros(N), 0.7 * TIME),
    "standing": world_from_base(*NOISE.normal(0, 0.01, (3, N)), z=NOISE.normal(0, 0.03, N)),
    "short": world_from_base(np.linspace(0, 0.4, 10), np.zeros(10), np.zeros(10), z=np.linspace(0, 0.4, 10)),
    "one pose": OUT_AND_BACK[:1],
    "reset": np.concatenate([OUT_AND_BACK[:400], motion(OUT_AND_BACK[400:])]),
    "elevator": world_from_base(
        *(np.append(v, np.full(40, v[-1])) for v in WAVES), z=np.append(np.zeros(N + 1), np.linspace(0, 3.5, 40))
    ),
    "2 Hz": OUT_AND_BACK[::5],
}


@pytest.mark.parametrize("name", GOOD)
def test_an_ordinary_robot_passes_unchanged(name):
    given = trajectory(GOOD[name])
    for camera in (CAMERA, pitched(0), pitched(60)):
        checked, notes = floor_trajectory(given, camera)
        assert checked is given
        assert all("if it" in note for note in notes)


@pytest.mark.parametrize("name", ["corridor_rgbd/odometry.txt", "corridor_rgbd/groundtruth.txt"])
def test_real_runs_pass_unchanged(data, name):
    given = read_tum(data(name))
    checked, notes = floor_trajectory(given, CAMERA)
    assert checked is given and notes == ()


@pytest.mark.parametrize("name", ["gt.kitti.gz", "denseGt2.kitti.gz", "rtabmap.kitti.gz"])
def test_real_pose_graphs_pass_unchanged(data, name):
    given = read(data("d5_pose_graph") / name)
    checked, notes = floor_trajectory(given, CAMERA)
    assert checked is given and notes == ()


@pytest.mark.parametrize("name", ["acapulco", "aces", "fhw", "freiburg-101", "infinite-corridor", "intel"])
def test_real_robot_paths_pass_unchanged(data, name):
    _, x, y, heading = np.loadtxt(data("robot_paths") / f"{name}.txt").T
    given = trajectory(world_from_base(x, y, heading))
    checked, notes = floor_trajectory(given, CAMERA)
    assert checked is given and notes == ()


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("camera", [pitched(0), CAMERA, pitched(60), CAMERA @ frame(turn(2, np.radians([20.0]))[0])])
def test_poses_of_the_optical_frame_are_put_right(path, camera):
    given = trajectory(PATHS[path] @ camera)
    checked, notes = floor_trajectory(given, camera)
    np.testing.assert_allclose(checked.poses, PATHS[path], atol=1e-9)
    assert checked.timestamps is given.timestamps and checked.path == given.path
    assert len(notes) == 1 and "optical frame" in notes[0] and "put right with T_base_camera" in notes[0]


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("start", ["first camera", "level"])
def test_visual_slam_in_the_cameras_world_is_put_right(path, start):
    poses = PATHS[path] @ CAMERA
    world = np.linalg.inv(poses[0]) if start == "first camera" else frame(OPTICAL.T, (1, 2, 3))
    checked, notes = floor_trajectory(trajectory(world @ poses), CAMERA)
    np.testing.assert_allclose(motion(checked.poses), motion(PATHS[path]), atol=1e-9)
    np.testing.assert_allclose(checked.poses[:, 2, 2], 1, atol=1e-9)
    assert len(notes) == 1 and "from a world that has the first camera's axes" in notes[0]


@pytest.mark.parametrize("path", [*PATHS, "quadruped"])
@pytest.mark.parametrize("start", ["level", "first camera"])
def test_poses_of_the_cameras_own_body_are_put_right(path, start):
    poses = GOOD[path] @ BODY
    world = np.eye(4) if start == "level" else np.linalg.inv(poses[0])
    checked, notes = floor_trajectory(trajectory(world @ poses), CAMERA)
    np.testing.assert_allclose(motion(checked.poses), motion(GOOD[path]), atol=1e-9)
    assert len(notes) == 1 and "the camera's own body" in notes[0]


def test_a_level_optical_frame_is_put_right():
    checked, notes = floor_trajectory(trajectory(WAVE @ frame(OPTICAL)), CAMERA)
    np.testing.assert_allclose(checked.poses[:, :3, :3], WAVE[:, :3, :3], atol=1e-9)
    assert len(notes) == 1 and "taken as level" in notes[0]


REFUSED = {
    "w first": (w_first, "written qw qx qy qz.*Write the columns as `timestamp tx ty tz qx qy qz qw`"),
    "w first, optical": (lambda p: w_first(p @ CAMERA), "written qw qx qy qz"),
    "base FRD": (
        lambda p: p @ frame(HALF_TURN),
        r"upside down.*FRD.*Give .* base_link .*diag\(1, -1, -1, 1\)",
    ),
    "world NED": (lambda p: frame(HALF_TURN) @ p, "upside down.*NED"),
    "y up": (lambda p: frame(Y_UP.T) @ p, "path leaves the floor: the file's world has its y axis up.*from the left"),
    "y down": (lambda p: frame(OPTICAL.T) @ p, "path leaves the floor: the file's world has its y axis down"),
    "OpenGL": (lambda p: p @ CAMERA @ frame(HALF_TURN), "a camera with OpenGL's axes.*Give the poses of base_link"),
    "OpenGL, y up": (lambda p: frame(Y_UP.T) @ p @ CAMERA @ frame(HALF_TURN), "a camera with OpenGL's axes"),
    "inverse": (invert, r"its poses are inverted.*Write the inverse of each pose"),
    "inverse of the camera's": (lambda p: invert(p @ CAMERA), "its poses are inverted"),
    "a marker": (
        lambda p: p @ frame(rotation_from_quaternion(np.array([[0.6, 0.5, 0.3, 0.2]]))[0]),
        r"stands upright .* in 0% of the poses only; the moving frame turns about its axis \(.*Give the poses of base",
    ),
}


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("fault", REFUSED)
def test_other_frames_are_refused_by_name(path, fault):
    change, words = REFUSED[fault]
    with pytest.raises(ValueError, match=f"run/odometry.txt: .*{words}"):
        floor_trajectory(trajectory(change(PATHS[path])), CAMERA)


@pytest.mark.parametrize("path", ["U-turn", "waves", "circle", "reversing", "out and reversing", "quadruped", "ramp"])
def test_conjugated_quaternions_are_refused(path):
    poses = GOOD[path]
    flipped = poses_from(np.swapaxes(poses[:, :3, :3], 1, 2), poses[:, :3, 3])
    with pytest.raises(ValueError, match="turns left where its path turns right: the quaternions are conjugated"):
        floor_trajectory(trajectory(flipped), CAMERA)


@pytest.mark.parametrize("path", ["U-turn", "waves"])
def test_angles_in_the_wrong_unit_are_refused(path):
    with pytest.raises(ValueError, match="degrees were taken for radians"):
        floor_trajectory(trajectory(headed(PATHS[path], 180 / np.pi)), CAMERA)
    x, y, heading = driven(np.full(N, 0.5), np.where((TIME > 20) & (TIME < 40), np.pi / 20, 0.0))
    with pytest.raises(ValueError, match="radians were taken for degrees"):
        floor_trajectory(trajectory(world_from_base(x, y, np.radians(heading))), CAMERA)


@pytest.mark.parametrize("name", ["aces", "intel"])
def test_degrees_at_a_low_rate_are_refused(data, name):
    _, x, y, heading = np.loadtxt(data("robot_paths") / f"{name}.txt").T
    with pytest.raises(ValueError, match=r"heading jumps about.*degrees were taken for"):
        floor_trajectory(trajectory(world_from_base(x, y, np.degrees(heading))), CAMERA)


def test_w_first_near_half_a_turn_looks_upright_and_is_refused():
    poses = w_first(world_from_base(*driven(np.full(N, 0.5), 0.1 * np.sin(TIME / 2), np.pi)))
    assert (poses[:, 2, 2] > np.cos(np.radians(25))).mean() > 0.9
    with pytest.raises(ValueError, match="written qw qx qy qz"):
        floor_trajectory(trajectory(poses), CAMERA)


@pytest.mark.parametrize(
    "degrees, words", [(90, "to its right"), (-90, "to its left"), (180, "backwards"), (None, "at any angle")]
)
def test_a_robot_that_does_not_drive_forwards_is_noted(degrees, words):
    poses = GOOD["sideways too"] if degrees is None else WAVE @ frame(turn(2, np.radians([float(degrees)]))[0])
    if degrees is None:
        poses = world_from_base(np.cumsum(0.05 * np.cos(TIME / 4)), np.cumsum(0.05 * np.sin(TIME / 4)), np.zeros(N))
    checked, notes = floor_trajectory(trajectory(poses), CAMERA)
    assert checked.poses is poses and len(notes) == 1 and words in notes[0]


def test_a_long_log_is_judged_by_a_part_of_it():
    poses = np.repeat(OUT_AND_BACK, 100, axis=0)
    long = dataclasses.replace(trajectory(poses @ CAMERA), timestamps=np.arange(len(poses)) * 0.001)
    checked, _ = floor_trajectory(long, CAMERA)
    np.testing.assert_allclose(checked.poses, poses, atol=1e-9)


@pytest.mark.parametrize("path", PATHS)
def test_a_first_line_that_names_the_columns_is_the_remedy_for_w_first(tmp_path, path):
    poses = PATHS[path]
    quaternion = quaternion_from_rotation(poses[:, :3, :3])
    rows = np.concatenate([TIME[:, None], poses[: len(TIME), :3, 3], quaternion[: len(TIME)]], axis=1)
    np.savetxt(tmp_path / "odometry.txt", rows, header="timestamp tx ty tz qx qy qz qw")
    with pytest.raises(ValueError, match=r"odometry.txt: .*or make `# timestamp tx ty tz qw qx qy qz` the first line"):
        floor_trajectory(read_tum(tmp_path / "odometry.txt"), CAMERA)
    np.savetxt(tmp_path / "odometry.txt", rows, header="timestamp tx ty tz qw qx qy qz")
    checked, _ = floor_trajectory(read_tum(tmp_path / "odometry.txt"), CAMERA)
    np.testing.assert_allclose(checked.poses, poses[: len(TIME)], atol=1e-12)
