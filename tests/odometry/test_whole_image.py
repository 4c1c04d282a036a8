import dataclasses

import numpy as np
import pytest

from ebjax.geometry.camera import Camera, camera_over_floor
from ebjax.geometry.lean_numbers import turned
from ebjax.io.sequence import read_sequence
from ebjax.odometry.image_corners import image_corners, levelled, with_depth
from ebjax.odometry.image_matches import QUICK_SIDE, ImageFeatures, image_features, match_features, spread_rows
from ebjax.odometry.whole_image import measure_motion

WIDTH, HEIGHT, AHEAD = 640, 480, 0.27
ROOM = (np.array([-4.0, -1.2]), np.array([6.0, 1.5]))
BEND, SPIN = (0.22, 0.05, 0.25), (0.0, 0.0, 0.3)


@pytest.fixture(scope="module")
def camera():
    over = camera_over_floor(615.0, 615.0, 320.0, 240.0, WIDTH, HEIGHT, 0.54, 0.33, 0.0, AHEAD)
    return Camera(np.asarray(over.intrinsics), np.asarray(over.base_from_camera), WIDTH, HEIGHT)


def matrix(motion):
    x, y, theta = motion
    out = np.eye(4)
    out[:2] = [[np.cos(theta), -np.sin(theta), 0, x], [np.sin(theta), np.cos(theta), 0, y]]
    return out


def depth_of(camera, pixels, room_from_base):
    """Depth of a bare room, m: the nearest of the floor and four walls along each pixel's ray."""
    pose = room_from_base @ camera.base_from_camera
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.intrinsics).T @ pose[:3, :3].T
    with np.errstate(divide="ignore"):
        floor = np.where(rays[:, 2] < 0, -pose[2, 3] / rays[:, 2], np.inf)
        sides = np.where(rays[:, :2] > 0, (ROOM[1] - pose[:2, 3]) / rays[:, :2], (ROOM[0] - pose[:2, 3]) / rays[:, :2])
    walls = sides.min(1)
    return np.minimum(floor, walls), floor < walls


def two_views(camera, motion, seed=0, *, count=300, noise=0.3, floor=True, wrong=0.1):
    """Corners of a room seen twice, with descriptors that match, and what image i says of those of image j."""
    random = np.random.default_rng(seed)
    pixels_j = random.uniform([2, 2], [WIDTH - 3, HEIGHT - 3], (8 * count, 2))
    depth, on_floor = depth_of(camera, pixels_j, np.eye(4))
    rays = np.column_stack([pixels_j, np.ones(len(pixels_j))]) @ np.linalg.inv(camera.intrinsics).T
    pose = camera.base_from_camera
    local = np.column_stack([rays * depth[:, None], np.ones(len(rays))])
    moved = local @ (np.linalg.inv(pose) @ matrix(motion) @ pose).T
    pixels_i = (moved[:, :3] @ camera.intrinsics.T)[:, :2] / np.maximum(moved[:, 2:3], 1e-3)
    ok = (moved[:, 2] > 0.4) & (pixels_i > 1).all(1) & (pixels_i < [WIDTH - 2, HEIGHT - 2]).all(1) & (floor | ~on_floor)
    pixels_i, pixels_j = pixels_i[ok][:count], pixels_j[ok][:count]
    pixels_i = pixels_i + noise * random.standard_normal(pixels_i.shape)
    lost = random.permutation(len(pixels_i))[: int(wrong * len(pixels_i))]
    pixels_i[lost] = random.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (len(lost), 2))
    descriptors = np.abs(random.standard_normal((len(pixels_i), 128))).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    sizes = np.full(len(pixels_i), 4.0)
    return ImageFeatures(pixels_i, descriptors, sizes), ImageFeatures(pixels_j, descriptors, sizes)


def with_more(features, pixels, seed):
    random = np.random.default_rng(seed)
    more = np.abs(random.standard_normal((len(pixels), 128))).astype(np.float32)
    more /= np.linalg.norm(more, axis=1, keepdims=True)
    return ImageFeatures(
        np.concatenate([features.keypoints, pixels]),
        np.concatenate([features.descriptors, more]),
        np.concatenate([features.sizes_px, np.full(len(pixels), 4.0)]),
    )


def depth_image(camera, room_from_base):
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    return depth_of(camera, pixels, room_from_base)[0].reshape(HEIGHT, WIDTH).astype(np.float32)


@pytest.mark.parametrize("motion", [BEND, SPIN, (0.25, 0.0, 0.0), (0.0, 0.0, 0.0), (0.1, -0.02, -0.5)])
def test_floor_gives_all_of_the_motion(camera, motion):
    found = measure_motion(*two_views(camera, motion), camera)
    assert found.kind == "floor" and found.ok and found.inliers > 0.85 * found.matches
    np.testing.assert_allclose(found.i_from_j[:2], motion[:2], atol=0.004)
    assert abs(found.i_from_j[2] - motion[2]) < 0.001
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


def leant(camera, features, pitch_deg, roll_deg):
    """Corners of a room, of known depth, as the camera of a robot that leans sees them."""
    depth = depth_of(camera, features.keypoints, np.eye(4))[0]
    pose = np.asarray(camera.base_from_camera, np.float64)
    rays = np.column_stack([features.keypoints, np.ones(len(depth))]) @ np.linalg.inv(camera.intrinsics).T
    points = np.column_stack([rays * depth[:, None], np.ones(len(depth))]) @ pose.T
    pitch, roll = np.radians([[pitch_deg], [roll_deg]]).astype(float)
    level_from_base = (turned(1, pitch) @ turned(0, roll))[0]
    seen = points @ np.linalg.inv(level_from_base @ pose).T
    pixels = (seen[:, :3] / seen[:, 2:3]) @ camera.intrinsics.T
    return dataclasses.replace(features, keypoints=pixels[:, :2], depth_m=seen[:, 2]), level_from_base, depth


@pytest.mark.parametrize("lean", [(1.0, 0.0), (0.0, -1.5), (-2.0, 1.0)])
def test_corners_of_a_robot_that_leans_are_put_where_an_upright_one_would_see_them(camera, lean):
    upright = two_views(camera, BEND)[1]
    seen, level_from_base, depth = leant(camera, upright, *lean)
    found = levelled(seen, camera, level_from_base)
    np.testing.assert_allclose(found.keypoints, upright.keypoints, atol=1e-8)
    np.testing.assert_allclose(found.depth_m, depth, atol=1e-9)
    flat = levelled(dataclasses.replace(seen, depth_m=None), camera, level_from_base)
    off = np.linalg.norm(flat.keypoints - upright.keypoints, axis=1)
    moved = np.linalg.norm((level_from_base @ camera.base_from_camera - camera.base_from_camera)[:3, 3])
    assert flat.depth_m is None and (off * depth < 1.5 * moved * camera.intrinsics[0, 0]).all()


@pytest.mark.parametrize("floor, atol", [(True, 0.002), (False, 0.006)])
def test_a_nod_while_the_whole_image_measures(camera, floor, atol):
    later, earlier = two_views(camera, BEND, floor=floor)
    seen, level_from_base, _ = leant(camera, earlier, 1.0, -0.5)
    prior = np.array([0.25, 0.04, 0.27]), np.diag([0.05, 0.03, 0.05]) ** 2
    found = measure_motion(
        later, levelled(dataclasses.replace(seen, depth_m=None), camera, level_from_base), camera, prior
    )
    bent = measure_motion(later, dataclasses.replace(seen, depth_m=None), camera, prior)
    assert found.ok and abs(found.i_from_j[2] - BEND[2]) < atol
    assert abs(bent.i_from_j[2] - BEND[2]) > abs(found.i_from_j[2] - BEND[2])


@pytest.mark.parametrize("motion", [BEND, SPIN])
def test_depth_gives_all_of_it_from_walls(camera, motion):
    views = two_views(camera, motion, floor=False)
    depth_j, depth_i = depth_image(camera, np.eye(4)), depth_image(camera, np.linalg.inv(matrix(motion)))
    depth_i[:, :100] = 0
    depth_j[:40] = np.nan
    deep = with_depth(views[0], depth_i, camera), with_depth(views[1], depth_j, camera)
    found = measure_motion(*deep, camera)
    assert found.kind == "depth" and found.ok
    np.testing.assert_allclose(found.i_from_j[:2], motion[:2], atol=0.01)
    assert abs(found.i_from_j[2] - motion[2]) < 0.001
    # One depth image alone says nothing.
    assert measure_motion(deep[0], views[1], camera).kind == "rotation"


@pytest.mark.parametrize("motion", [BEND, (AHEAD * (1 - np.cos(0.3)), -AHEAD * np.sin(0.3), 0.3)])
def test_walls_alone_give_the_angle(camera, motion):
    views = two_views(camera, motion, floor=False)
    found = measure_motion(*views, camera)
    assert found.kind == "rotation" and found.ok
    assert abs(found.i_from_j[2] - motion[2]) < 0.004
    np.testing.assert_array_equal(found.i_from_j[:2], 0)
    np.testing.assert_array_equal(found.covariance[:2, :2], np.eye(2))


def test_a_sideways_move_along_walls_looks_like_a_turn_and_is_not_ok_without_a_prior(camera):
    views = two_views(camera, SPIN, floor=False)
    found = measure_motion(*views, camera)
    assert found.kind == "rotation"
    assert not found.ok or abs(found.i_from_j[2] - SPIN[2]) < 0.01
    told = measure_motion(*views, camera, prior=(np.array([0.01, 0.0, 0.27]), np.diag([0.02, 0.01, 0.05]) ** 2))
    assert abs(told.i_from_j[2] - SPIN[2]) < 0.01


def test_a_rotation_takes_its_length_from_the_prior(camera):
    wide = np.diag([0.05, 0.03, 0.05]) ** 2
    found = measure_motion(*two_views(camera, BEND, floor=False), camera, prior=(np.array([0.25, 0.04, 0.27]), wide))
    assert found.kind == "rotation" and found.ok
    np.testing.assert_allclose(found.i_from_j[:2], BEND[:2], atol=0.05)
    assert abs(found.i_from_j[2] - BEND[2]) < 0.003
    np.testing.assert_allclose(found.covariance[:2, :2], wide[:2, :2])
    assert found.covariance[2, 2] < wide[2, 2] / 10


def test_errors_are_those_of_the_covariance(camera):
    theta, whole = [], []
    for seed in range(30):
        found = measure_motion(*two_views(camera, BEND, seed, count=120, noise=0.5), camera)
        c, s = np.cos(BEND[2]), np.sin(BEND[2])
        error = found.i_from_j - BEND
        error[:2] = [c * error[0] + s * error[1], c * error[1] - s * error[0]]
        theta.append(error[2] ** 2 / found.covariance[2, 2])
        whole.append(error @ np.linalg.solve(found.covariance, error))
    # Corners here are independent, as those of an image are not: the factor for that makes these small.
    assert 0.2 < np.mean(theta) < 1.6
    assert 0.6 < np.mean(whole) < 4.5


def test_the_robots_own_body_is_no_motion(camera):
    one, two = two_views(camera, SPIN, count=120)
    body = np.random.default_rng(1).uniform([100, 400], [540, 479], (150, 2))
    found = measure_motion(with_more(one, body, 2), with_more(two, body, 2), camera)
    assert found.ok and abs(found.i_from_j[2] - SPIN[2]) < 0.002


def test_a_person_who_walks_is_no_motion(camera):
    one, two = two_views(camera, (0.0, 0.0, 0.0), count=150)
    random = np.random.default_rng(1)
    person = random.uniform([250, 50], [380, 400], (60, 2))
    found = measure_motion(with_more(one, person + np.array([25, 4]), 2), with_more(two, person, 2), camera)
    assert found.ok
    np.testing.assert_allclose(found.i_from_j, 0, atol=0.004)


def test_a_floor_that_repeats_gives_an_angle_and_the_prior_the_place(camera):
    one, two = two_views(camera, (0.25, 0.0, 0.02), count=100)
    again, twice = two_views(camera, (-0.25, 0.0, 0.02), 1, count=130)
    views = [
        ImageFeatures(
            *(np.concatenate([getattr(f, n), getattr(g, n)]) for n in ("keypoints", "descriptors", "sizes_px"))
        )
        for f, g in ((one, again), (two, twice))
    ]
    found = measure_motion(*views, camera)
    assert found.kind == "rotation" and abs(found.i_from_j[2] - 0.02) < 0.002
    told = measure_motion(*views, camera, prior=(np.array([0.27, 0.0, 0.0]), np.diag([0.05, 0.03, 0.05]) ** 2))
    assert told.kind == "floor" and told.ok
    np.testing.assert_allclose(told.i_from_j, [0.25, 0, 0.02], atol=0.006)


def test_chance_is_not_ok(camera):
    random = np.random.default_rng(0)
    few = [dataclasses.replace(f, **{n: getattr(f, n)[:6] for n in ("keypoints", "descriptors", "sizes_px")})
           for f in two_views(camera, BEND)]  # fmt: skip
    assert not measure_motion(*few, camera).ok
    empty = ImageFeatures(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0))
    found = measure_motion(empty, empty, camera)
    assert not found.ok and found.matches == 0 and "not ok" in repr(found) and "\n" not in repr(found)
    for _ in range(10):
        one, two = two_views(camera, BEND, count=60)
        one = dataclasses.replace(one, keypoints=random.uniform([0, 0], [639, 479], (60, 2)))
        assert not measure_motion(one, two, camera).ok


def picture(height, width, seed=0):
    import cv2

    random = np.random.default_rng(seed)
    noise = random.integers(0, 255, (height // 8, width // 8, 3), dtype=np.uint8)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)


def test_features_are_spread_masked_and_match_themselves():
    rgb = picture(240, 320)
    features = image_features(rgb, count=200)
    assert len(features) == 200
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, atol=1e-3)
    rows, partners = match_features(features, features)
    np.testing.assert_array_equal(rows, partners)
    mask = np.ones((240, 320), bool)
    mask[120:] = False
    assert image_features(rgb, mask).keypoints[:, 1].max() < 122
    with pytest.raises(ValueError, match="mask"):
        image_features(rgb, mask[:100])
    assert len(image_features(np.zeros((240, 320, 3), np.uint8))) == 0


def test_large_images_are_halved_and_pixels_stay_those_of_the_raw_image():
    rgb = picture(540, 1920)
    two = image_features(rgb)
    one = image_features(np.roll(rgb, (6, 10), (0, 1)))
    rows, partners = match_features(one, two)
    assert two.unit_px == 2 and len(rows) > 100
    assert image_features(rgb, longest_side=QUICK_SIDE).unit_px == 4
    moved = np.median(one.keypoints[rows] - two.keypoints[partners], 0)
    np.testing.assert_allclose(moved, [10, 6], atol=0.1)


def test_spread_takes_the_strongest_of_every_cell_first():
    points = np.array([[1.0, 1], [2, 2], [3, 3], [50, 1], [50, 50]])
    rows = spread_rows(points, np.array([3.0, 9, 5, 1, 2]), 10.0, 4)
    assert list(rows) == [1, 4, 3, 2]


@pytest.mark.parametrize("depth", [False, True])
def test_the_turn_of_a_real_floor(data, depth):
    sequence = read_sequence(data("corridor_rgbd"), odometry=False)
    file = sequence.camera
    camera = Camera(file.intrinsics, file.base_from_camera, file.width, file.height)
    for i, j in ((76, 77), (84, 85), (84, 86), (90, 92)):
        seen = [image_corners(sequence.rgb(k), sequence.depth(k) if depth else None, camera) for k in (i, j)]
        found = measure_motion(*seen, camera)
        truth = np.linalg.inv(sequence.world_from_base[i]) @ sequence.world_from_base[j]
        assert found.ok and found.kind == ("depth" if depth else "floor")
        assert abs(np.degrees(found.i_from_j[2] - np.arctan2(truth[1, 0], truth[0, 0]))) < 0.2
        np.testing.assert_allclose(found.i_from_j[:2], truth[:2, 3], atol=0.006)
