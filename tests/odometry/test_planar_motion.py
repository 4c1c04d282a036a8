import numpy as np
import pytest

from ebjax.geometry.camera import Camera, camera_over_floor
from ebjax.odometry.planar_motion import base_motion, camera_motion, make_pairs
from ebjax.odometry.planar_motion_cost import WRONG_COST, explain, quick_score, score
from ebjax.odometry.planar_motion_fit import polish, refine, search, turn_width
from ebjax.odometry.planar_motion_search import epipolar_pairs, floor_votes, rigid_pairs, turn_peaks

HEIGHT, AHEAD, PITCH = 0.54, 0.27, 0.33
MOTIONS = {
    "straight": (0.25, 0.0, 0.0),
    "turn on the spot": (0.0, 0.0, 0.3),
    "turn of the camera alone": (AHEAD * (1 - np.cos(-0.4)), -AHEAD * np.sin(-0.4), -0.4),
    "bend": (0.22, 0.05, 0.25),
    "backwards": (-0.3, 0.02, -0.1),
    "stands": (0.0, 0.0, 0.0),
}


def mounted():
    camera = camera_over_floor(615.0, 615.0, 320.0, 240.0, 640, 480, HEIGHT, PITCH, 0.0, AHEAD)
    return Camera(np.asarray(camera.intrinsics), np.asarray(camera.base_from_camera), 640, 480)


def seen(camera, points):
    """Pixels and depth of points in base."""
    pose = np.asarray(camera.base_from_camera)
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    pixels = local @ np.asarray(camera.intrinsics).T
    return pixels[:, :2] / np.where(pixels[:, 2:] > 0.05, pixels[:, 2:], np.inf), local[:, 2]


def scene(motion, random, floor=60, walls=60):
    """Points of base_j that both images see, on the floor and above it, and their pixels and depth in i and j."""
    camera, points = mounted(), []
    x, y, theta = motion
    turn = np.array([[np.cos(theta), -np.sin(theta), 0], [np.sin(theta), np.cos(theta), 0], [0, 0, 1]])
    for count, low, high in ((floor, 0.0, 0.0), (walls, 0.4, 2.5)):
        bearing, distance = random.uniform(-1.2, 1.2, 20000), random.uniform(0.7, 5.0, 20000)
        cloud = np.column_stack(
            [distance * np.cos(bearing), distance * np.sin(bearing), random.uniform(low, high, 20000)]
        )
        ok = np.ones(20000, bool)
        for moved in (cloud, cloud @ turn.T + [x, y, 0]):
            pixels, depth = seen(camera, moved)
            ok &= (depth > 0.45) & (pixels > 0).all(1) & (pixels < [639, 479]).all(1)
        points.append(cloud[ok][:count])
    points = np.concatenate(points)
    return camera, *seen(camera, points @ turn.T + [x, y, 0]), *seen(camera, points)


def pairs_of(motion, random, noise=0.0, wrong=0.0, depth=False, **counts):
    camera, pixels_i, depth_i, pixels_j, depth_j = scene(motion, random, **counts)
    pixels_i = pixels_i + noise * random.standard_normal(pixels_i.shape)
    pixels_j = pixels_j + noise * random.standard_normal(pixels_j.shape)
    lost = random.permutation(len(pixels_i))[: int(wrong * len(pixels_i))]
    pixels_i[lost] = random.uniform([0, 0], [639, 479], (len(lost), 2))
    order = random.permutation(len(pixels_i))
    pixels_i, pixels_j = pixels_i[order], pixels_j[order]
    depths = (depth_i[order], depth_j[order]) if depth else ()
    return make_pairs(pixels_i, pixels_j, camera, np.full(len(pixels_i), max(noise, 0.3)), *depths)


def test_motions_of_base_and_camera_are_inverse():
    motion, xy = np.random.default_rng(0).uniform(-1, 1, (7, 3)), np.array([0.3, -0.1])
    np.testing.assert_allclose(camera_motion(base_motion(motion, xy), xy), motion, atol=1e-14)
    # The optical centre of a turning base goes along an arc.
    np.testing.assert_allclose(
        camera_motion(np.array([0.0, 0.0, np.pi / 2]), xy)[:2], [0.1 - 0.3, 0.3 + 0.1], atol=1e-14
    )


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("depth", [False, True])
def test_the_true_motion_leaves_no_residual(name, depth):
    pairs = pairs_of(MOTIONS[name], np.random.default_rng(1), depth=depth)
    truth = camera_motion(np.array([MOTIONS[name]]), pairs.camera_xy)
    at = explain(truth, pairs)
    np.testing.assert_allclose(at.residuals, 0, atol=1e-4)
    if name not in ("stands", "turn of the camera alone"):
        assert at.floor.sum() == (0 if depth else 60)
    assert quick_score(truth, pairs)[0] < 0.5 * WRONG_COST * len(pairs)
    assert explain(truth + np.array([0, 0, 0.05]), pairs).cost.mean() > WRONG_COST


def test_a_point_behind_the_camera_or_beyond_the_floor_is_wrong():
    pairs = pairs_of((0.25, 0.0, 0.0), np.random.default_rng(2))
    assert (explain(np.array([[0.0, 0.0, np.pi]]), pairs).cost > WRONG_COST).all()
    # Corners of the floor that moved half as far as they should: something below it, or that moves with the robot.
    slow = pairs_of((0.125, 0.0, 0.0), np.random.default_rng(2), walls=0)
    assert (explain(np.array([[0.25, 0.0, 0.0]]), slow).cost > WRONG_COST).mean() > 0.8
    assert (explain(np.array([[0.25, 0.0, 0.0]]), slow, floor=False).cost < WRONG_COST).mean() > 0.8


def test_hypotheses_hold_the_truth():
    random = np.random.default_rng(3)
    motion = np.array(MOTIONS["bend"])
    pairs = pairs_of(motion, random)
    b = camera_motion(motion, pairs.camera_xy)
    unit = np.append(b[:2] / np.linalg.norm(b[:2]), b[2])
    near = lambda hypotheses, truth, atol: np.abs(hypotheses - truth).max(1).min() < atol  # noqa: E731
    assert near(epipolar_pairs(pairs, 50, random), unit, 2e-3)
    assert near(rigid_pairs(pairs, 50, random), b, 1e-6)
    assert near(floor_votes(b[2], pairs, 3), b, 1e-6)
    alone = pairs_of(MOTIONS["turn of the camera alone"], random)
    assert near(turn_peaks(alone, 1), np.array([0, 0, -0.4]), 1e-6)


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("wrong", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["floor", "depth", "rotation"])
def test_search_finds_the_motion_among_wrong_matches(name, wrong, kind):
    pairs = pairs_of(MOTIONS[name], np.random.default_rng(4), wrong=wrong, depth=kind == "depth")
    fit = search(pairs, np.zeros((1, 3)), floor=kind != "rotation")
    right = explain(fit.motions[:1], pairs, floor=kind != "rotation").cost[0] < WRONG_COST
    assert right.mean() > 0.95 * (1 - wrong)
    found = base_motion(fit.motions[0], pairs.camera_xy)
    truth = np.array(MOTIONS[name])
    if kind != "rotation":
        np.testing.assert_allclose(found, truth, atol=2e-4)
        return
    assert abs(found[2] - truth[2]) < 1e-3
    b, true_b = fit.motions[0, :2], camera_motion(truth, pairs.camera_xy)[:2]
    if np.linalg.norm(true_b) > 0.05:
        assert b @ true_b > 0.999 * np.linalg.norm(b) * np.linalg.norm(true_b)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["floor", "depth", "rotation"])
def test_covariance_matches_the_errors(kind):
    random, nees = np.random.default_rng(5), []
    truth = camera_motion(np.array(MOTIONS["bend"]), np.array([AHEAD, 0.0]))
    for _ in range(40):
        pairs = pairs_of(MOTIONS["bend"], random, noise=0.4, wrong=0.1, depth=kind == "depth", floor=40, walls=40)
        floor = kind != "rotation"
        start = refine(truth[None], pairs, 3, floor=floor).motions[0]
        motion, covariance = polish(start, pairs, start, 1e-3 * np.eye(3), floor=floor)
        nees.append((motion[2] - truth[2]) ** 2 / covariance[2, 2])
    assert 0.4 < np.mean(nees) < 2.2 and np.max(nees) < 20


def test_turn_width_tells_a_narrow_cluster_from_a_wide_view():
    random = np.random.default_rng(6)
    pairs = pairs_of(MOTIONS["bend"], random, noise=0.3, floor=0, walls=120)
    truth = camera_motion(np.array(MOTIONS["bend"]), pairs.camera_xy)
    middle = np.linalg.norm(pairs.pixels_i - np.median(pairs.pixels_i, 0), axis=1)
    cluster = pairs.take(np.argsort(middle)[:15])
    assert turn_width(truth, cluster) > 2 * turn_width(truth, pairs)


def test_a_turn_can_be_held():
    pairs = pairs_of(MOTIONS["bend"], np.random.default_rng(7))
    truth = camera_motion(np.array([MOTIONS["bend"]]), pairs.camera_xy)
    fit = refine(truth + np.array([0.01, 0.01, 0.02]), pairs, 4, floor=False, turns=False)
    assert fit.motions[0, 2] == pytest.approx(truth[0, 2] + 0.02, abs=1e-9)
    assert fit.scores[0] > score(explain(truth, pairs, floor=False).cost)[0]
