import numpy as np
import pytest

from ebjax.features.settle import PairMatches
from ebjax.features.verify_pairs import rows_of
from ebjax.geometry.camera import camera_over_floor
from ebjax.geometry.planar import between, chained, compose, log
from ebjax.odometry.chain import Edges
from ebjax.odometry.clock import TimeOffset
from ebjax.odometry.floor_steps import FloorPairs
from ebjax.odometry.motion import Motion
from ebjax.odometry.mount import Tilt
from ebjax.odometry.steps import Steps
from ebjax.odometry.wheels import WheelErrors
from ebjax.slam.measured import Measured
from ebjax.slam.path import path_of_motion, path_of_wheels

ERRORS = WheelErrors()
FRAMES = np.array([0, 4, 8, 12, 16, 20])
COUNT = 24


def way_of(turn=0.03, step=0.05):
    """The wheels' path over all frames, from somewhere."""
    path = chained(np.tile([step, 0.0, turn], (COUNT - 1, 1)))
    return compose(np.broadcast_to([1.0, -2.0, 3.0], path.shape), path)


def edges_between(poses, i, j):
    """What the poses have between rows."""
    information = np.tile(np.diag([1e4, 2e4, 4e4]), (len(i), 1, 1))
    return Edges(i, j, between(poses[i], poses[j]), information, np.zeros(len(i), bool))


def motion_of(poses, frames=FRAMES):
    """A settled chain, and a longer step over two keyframes."""
    rows = np.arange(len(poses) - 1)
    chain = edges_between(poses, rows, rows + 1)
    none, flat = np.zeros(0, int), np.zeros((0, 8, 2))
    steps = Steps(
        none, none, np.zeros(0, object), none, none, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, object)
    )
    deep = np.zeros((0, 8, 3))
    matches = PairMatches(flat, flat, deep, deep, np.zeros((0, 8), bool), np.zeros((0, 3)), np.zeros((0, 8, 2, 2)))
    return Motion(
        frames=frames,
        camera=camera_over_floor(400.0, 400.0, 320.0, 240.0, 640, 480, 0.6, 0.5),
        poses=poses,
        covariance=np.linalg.inv(chain.information),
        chain=chain,
        further=edges_between(poses, np.array([2]), np.array([0])),
        steps=steps,
        wheels=None,
        offset=TimeOffset(),
        tilt=Tilt(),
        reach=None,
        jumps=(),
        carried=0,
        trust_depth=False,
        warnings=(),
        pairs=FloorPairs(none, none, none, none, rows_of(matches)),
        bridged=steps,
    )


def settled_of(way, scale=1.0, turn=0.0):
    """What the floor makes of the wheels' path between keyframes."""
    steps = between(way[FRAMES[:-1]], way[FRAMES[1:]]) * [scale, scale, 1.0] + [0, 0, turn]
    return chained(steps)


def closures(i, j, covariance=None):
    """One measured closure between two frames."""
    covariance = np.diag([1e-4, 1e-4, 1e-5]) if covariance is None else covariance
    one = np.ones(2, int)
    return Measured(
        np.array([i, i]), np.array([j, j]), np.zeros(2, bool), np.zeros(2), one, one,
        np.array([[9.0, 9.0, 1.0], [0.1, 0.2, 0.3]]), np.stack([np.eye(3), covariance]),
    )  # fmt: skip


def check_edges(graph):
    """Every edge that is no closure says what the start says."""
    rows = ~graph.robust
    off = log(between(graph.measured[rows], between(graph.poses[graph.i[rows]], graph.poses[graph.j[rows]])))
    np.testing.assert_allclose(off, 0, atol=1e-12)


def test_the_path_of_wheels_ties_every_frame_to_the_one_before():
    way = way_of(turn=0.2)
    path = path_of_wheels(way, ERRORS)
    graph = path.graph(closures(20, 3), np.array([False, True]))
    np.testing.assert_array_equal(graph.i, [*range(COUNT - 1), 20])
    np.testing.assert_array_equal(graph.j, [*range(1, COUNT), 3])
    np.testing.assert_array_equal(graph.robust, [False] * (COUNT - 1) + [True])
    check_edges(graph)
    np.testing.assert_allclose(graph.measured[-1], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(graph.information[-1], np.diag([1e4, 1e4, 1e5]), rtol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(graph.information[:-1]), ERRORS.step_covariance(way), rtol=1e-9)
    np.testing.assert_array_equal(path.covariance, ERRORS.step_covariance(way))
    assert path.everywhere(way + 1.0) is not way
    np.testing.assert_array_equal(path.everywhere(way + 1.0), way + 1.0)


def test_the_graph_of_a_motion_has_its_chain_its_longer_steps_and_the_closures():
    way = way_of()
    poses = settled_of(way, 1.05, 0.01)
    graph = path_of_motion(motion_of(poses), way).graph(closures(16, 4), np.array([False, True]))
    begin = np.broadcast_to(way[FRAMES[0]], poses.shape)
    np.testing.assert_allclose(graph.poses, compose(begin, poses), atol=1e-12)
    np.testing.assert_array_equal(graph.i, [0, 1, 2, 3, 4, 2, 4])
    np.testing.assert_array_equal(graph.j, [1, 2, 3, 4, 5, 0, 1])
    np.testing.assert_array_equal(graph.robust, [False] * 6 + [True])
    check_edges(graph)


def test_frames_of_wheels_that_agree_with_the_floor_lie_on_the_wheels():
    way = way_of()
    poses = way[FRAMES]
    off = between(path_of_motion(motion_of(poses), way).everywhere(poses), way)
    np.testing.assert_allclose(off, 0, atol=1e-12)


@pytest.mark.parametrize("scale,turn", [(1.0, 0.0), (1.2, 0.0), (0.8, 0.05), (1.05, -0.05)])
def test_keyframes_are_passed_exactly_and_what_lies_between_joins_them(scale, turn):
    way = way_of()
    poses = settled_of(way, scale, turn)
    path = path_of_motion(motion_of(poses), way)
    bent = compose(poses, np.random.default_rng(0).normal(0, 0.02, poses.shape))
    for nodes in (poses, bent):
        every = path.everywhere(nodes)
        assert every.shape == (COUNT, 3)
        np.testing.assert_allclose(every[FRAMES], nodes, rtol=0, atol=1e-14)
        # No frame is farther from the next than its share of the step, and no jump is left at a keyframe.
        moved = between(every[:-1], every[1:])[: FRAMES[-1]].reshape(-1, 4, 3)
        whole = between(nodes[:-1], nodes[1:])
        np.testing.assert_allclose(moved[:, :, 0], np.repeat(whole[:, :1] / 4, 4, 1), atol=0.01)
        np.testing.assert_allclose(moved[:, :, 2], np.repeat(whole[:, 2:] / 4, 4, 1), atol=1e-6)


@pytest.mark.parametrize("scale", [0.7, 1.0, 1.4])
def test_a_straight_drive_stays_monotone(scale):
    way = chained(np.tile([0.05, 0.0, 0.0], (COUNT - 1, 1)))
    poses = settled_of(way, scale)
    path = path_of_motion(motion_of(poses), way)
    nodes = poses * [1.2, 1.0, 1.0]
    every = path.everywhere(nodes)
    assert (np.diff(every[:, 0]) > 0).all()
    expected = np.interp(np.arange(FRAMES[-1] + 1), FRAMES, nodes[:, 0])
    np.testing.assert_allclose(every[: FRAMES[-1] + 1, 0], expected, atol=1e-12)
    np.testing.assert_allclose(every[:, 1:], 0, atol=1e-12)


def test_all_frames_move_with_nodes_that_move_rigidly():
    way = way_of()
    poses = settled_of(way, 1.1, 0.02)
    path = path_of_motion(motion_of(poses), way)
    before = path.everywhere(poses)
    rigid = np.array([3.0, -1.0, 2.0])
    after = path.everywhere(compose(np.broadcast_to(rigid, poses.shape), poses))
    off = between(after, compose(np.broadcast_to(rigid, before.shape), before))
    np.testing.assert_allclose(off, 0, atol=1e-12)


def test_frames_beyond_the_keyframes_hang_on_the_nearest():
    way = way_of()
    frames = FRAMES[1:-1]
    poses = settled_of(way, 1.1, 0.02)[1:-1]
    path = path_of_motion(motion_of(poses, frames), way)
    np.testing.assert_array_equal(path.row[frames[-1] :], len(frames) - 1)
    np.testing.assert_array_equal(path.row[: frames[0]], 0)
    bent = compose(poses, np.random.default_rng(0).normal(0, 0.05, poses.shape))
    every = path.everywhere(bent)
    for part, key in ((slice(frames[-1], COUNT), frames[-1]), (slice(0, frames[0] + 1), frames[0])):
        there, wheels = every[part], way[part]
        found = between(np.broadcast_to(every[key], there.shape), there)
        np.testing.assert_allclose(found, between(np.broadcast_to(way[key], wheels.shape), wheels), atol=1e-12)


def test_a_robot_that_rests_between_keyframes_stays_where_it_is():
    steps = np.tile([0.05, 0.0, 0.02], (COUNT - 1, 1))
    steps[4:8] = 0
    way = chained(steps)
    poses = settled_of(way)
    every = path_of_motion(motion_of(poses), way).everywhere(poses)
    np.testing.assert_allclose(every[4:9], np.broadcast_to(every[4], (5, 3)), atol=1e-12)
