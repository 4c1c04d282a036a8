import functools

import cv2
import numpy as np
import pytest

from ebjax.geometry.camera import camera_over_floor
from ebjax.geometry.homography import apply
from ebjax.io.image_folder import list_images
from ebjax.io.images import read_image
from ebjax.views.run_view import choose_floor, from_camera, without
from ebjax.views.static_pixels import spread, static_pixels

HEIGHT, WIDTH, HORIZON, FOCAL = 480, 640, 140, 500
NEAR = HORIZON + 20
"""Rows from here on show floor, up to 12 m away."""
FLOORS = ["marble", "tiles", "grout", "planks", "carpet", "smooth"]


def floor(kind, rng):
    """20 m of floor, 1 cm a pixel, 12 m wide."""
    noise = rng.normal(size=(2000, 1200)).astype(np.float32)
    y, x = np.mgrid[:2000, :1200]
    tile_lines = (x % 40 < 2) | (y % 40 < 2)
    image = {
        "marble": lambda: 130 + 250 * cv2.GaussianBlur(noise, (0, 0), 4) + 60 * cv2.GaussianBlur(noise, (0, 0), 1),
        "tiles": lambda: np.where(tile_lines, 70, 150 + 60 * cv2.GaussianBlur(noise, (0, 0), 2)),
        "grout": lambda: np.where(tile_lines, 70, 150),
        "planks": lambda: 120 + 12 * (x // 15 * 7 % 3) - 60 * (x % 15 < 1) - 60 * ((y + x // 15 * 53) % 120 < 1),
        "carpet": lambda: 110 + 15 * noise + 40 * cv2.GaussianBlur(noise, (0, 0), 3),
        "smooth": lambda: 120 + 400 * cv2.GaussianBlur(noise, (0, 0), 15),
    }[kind]()
    return np.clip(image, 0, 255).astype(np.float32)


@functools.cache
def seen(kind, count, wobble_px):
    """Grey images of a camera 0.5 m above a floor that drives straight, its heading trembling by so many pixels."""
    rng = np.random.default_rng(0)
    ground, images = cv2.GaussianBlur(floor(kind, rng), (0, 0), 0.7), []
    for along in spread(np.arange(800), count):
        # At depth z (cm) the row is HORIZON + FOCAL * 50 / z. Pixels average 2 x 2 rays.
        u, v = np.meshgrid(*((np.arange(2 * n, dtype=np.float32) - 0.5) / 2 for n in (WIDTH, HEIGHT)))
        depth = FOCAL * 50 / np.maximum(v - HORIZON, 1e-3)
        x, y = (u - WIDTH / 2 - np.float32(wobble_px * rng.normal())) * depth / FOCAL + 600, depth + np.float32(along)
        grey = np.where((depth > 1200) | (abs(x - 600) > 600), ground.mean(), cv2.remap(ground, x, y, cv2.INTER_LINEAR))
        images.append(cv2.resize(grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA))
    return images


def drive(kind, count=32, wobble_px=0.0, paint=None):
    """JPEG frames of a drive, exposed unevenly; `paint` draws on each of them."""
    rng, frames = np.random.default_rng(0), []
    for grey in seen(kind, count, float(wobble_px)):
        exposed = np.clip(grey * rng.uniform(0.7, 1.2), 0, 255).astype(np.uint8)
        frame = np.repeat(exposed[..., None], 3, axis=2)
        if paint is not None:
            paint(frame)
        frames.append(cv2.imdecode(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 85])[1], cv2.IMREAD_COLOR))
    return frames


def painter(inside, base=60, dots=0.02):
    """Draws a body over the pixels `inside`: grey, with screws and stickers, so many a pixel."""
    rng = np.random.default_rng(3)
    body = np.full((HEIGHT, WIDTH, 3), base, np.uint8)
    for _ in range(int(dots * HEIGHT * WIDTH / 16)):
        centre = int(rng.integers(WIDTH)), int(rng.integers(HEIGHT))
        cv2.circle(body, centre, int(rng.integers(4, 9)), [int(c) for c in rng.integers(0, 255, 3)], -1)

    def paint(frame):
        frame[inside] = body[inside]

    return paint


def lowest(share):
    return np.arange(HEIGHT)[:, None] * np.ones(WIDTH) >= HEIGHT * (1 - share)


def drawn(draw):
    canvas = np.zeros((HEIGHT, WIDTH), np.uint8)
    draw(canvas)
    return canvas > 0


def overlap(a, b):
    return (a & b)[NEAR:].sum() / (a | b)[NEAR:].sum()


@pytest.mark.slow
@pytest.mark.parametrize(("count", "wobble_px"), [(32, 0.0), (32, 6.0), (8, 0.0)])
@pytest.mark.parametrize("kind", FLOORS)
def test_a_floor_that_moves_is_not_masked(kind, count, wobble_px):
    found = static_pixels(drive(kind, count, wobble_px))
    # Dead straight, parallel lines farther than 2.5 m away are one pattern that stays.
    assert not found[HORIZON + 100 if wobble_px == 0 else NEAR :].any()
    assert found.mean() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["marble", "smooth", "carpet", "grout"])
@pytest.mark.parametrize("share", [0.1, 0.35, 0.45])
def test_a_textured_body_is_found(kind, share):
    body = lowest(share)
    found = static_pixels(drive(kind, wobble_px=6, paint=painter(body)))
    assert found[body].mean() > 0.97
    assert overlap(found, body) > (0.9 if share > 0.1 else 0.8)
    assert not found[NEAR : int(HEIGHT * (1 - share)) - 16].any()


def test_other_parts_are_found():
    columns = np.arange(WIDTH)
    irregular = np.arange(HEIGHT)[:, None] > 360 + 28 * np.sin(columns / 60) + 12 * (columns // 90 % 2)
    arm = np.array([[639, 300], [520, 280], [430, 330], [400, 300], [420, 380], [639, 420]])
    gripper = drawn(lambda canvas: cv2.fillPoly(canvas, [arm], 1))
    for body in irregular, gripper:
        found = static_pixels(drive("marble", wobble_px=6, paint=painter(body)))
        assert found[body].mean() > 0.95 and overlap(found, body) > 0.8


def test_dirt_and_captions_are_found_and_little_around_them():
    spots = [((180, 340), 12), ((400, 380), 18), ((520, 440), 28), ((80, 440), 10)]
    dirt = drawn(lambda canvas: [cv2.circle(canvas, centre, radius, 1, -1) for centre, radius in spots])
    caption = drawn(lambda canvas: cv2.putText(canvas, "CAM 1", (40, 440), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 1, 3))
    for part, value in (dirt, 30), (caption, 255):
        found = static_pixels(drive("marble", wobble_px=6, paint=lambda f, p=part, v=value: f.__setitem__(p, v)))
        assert found[part].mean() > 0.95
        assert not (found & (cv2.dilate(part.astype(np.uint8), np.ones((31, 31))) == 0))[NEAR:].any()


def test_black_frames_are_found():
    bars = ~lowest(0.88) | lowest(0.1)
    ring = drawn(lambda canvas: cv2.circle(canvas, (320, 240), 270, 1, -1)) == 0
    for part in bars, ring:
        found = static_pixels(drive("marble", wobble_px=6, paint=lambda f, p=part: f.__setitem__(p, 0)))
        assert overlap(found, part) > 0.9


def test_of_a_smooth_body_the_outline_is_found():
    body = np.arange(HEIGHT)[:, None] > 360 + 40 * (np.arange(WIDTH) / 320 - 1) ** 2
    found = static_pixels(drive("marble", wobble_px=6, paint=lambda f: f.__setitem__(body, 30)))
    outline = cv2.morphologyEx(body.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
    assert found[outline].mean() > 0.95
    assert not found[NEAR:340].any()


def test_nothing_where_the_robot_does_not_move_or_too_few_frames_tell():
    body = painter(lowest(0.3))
    frames = drive("marble", wobble_px=6, paint=body)
    assert not static_pixels([frames[0]] * 30).any()
    assert not static_pixels([*[frames[0]] * 30, *frames[:6]]).any()
    assert not static_pixels(frames[:7]).any()
    # Stood still for most of the images, but moved in enough of them.
    assert overlap(static_pixels([*[frames[0]] * 60, *frames[:12]]), lowest(0.3)) > 0.9
    # A robot that stands while people pass.
    rng = np.random.default_rng(0)
    passed = []
    for _ in range(20):
        frame = frames[0].copy()
        x = int(rng.integers(40, 560))
        frame[40:400, x : x + 80] = rng.integers(0, 255, 3)
        passed.append(frame)
    assert not static_pixels(passed).any()


def test_dark_and_noisy_images():
    rng = np.random.default_rng(1)
    body = lowest(0.3)
    frames = drive("marble", wobble_px=6, paint=painter(body))
    for gain, noise in (0.1, 0.0), (0.02, 0.0), (0.2, 3.0), (1.0, 10.0):
        images = [np.clip(gain * f + rng.normal(0, noise, f.shape), 0, 255).astype(np.uint8) for f in frames]
        found = static_pixels(images)
        assert not found[NEAR:320].any()
        assert gain < 0.1 or overlap(found, body) > 0.8
        assert not static_pixels([f[: HEIGHT - 150] for f in images])[NEAR:].any()


def test_sizes_and_iterators():
    frames = drive("marble", 9, 6, painter(lowest(0.35)))
    small = static_pixels(cv2.resize(f, (160, 120), interpolation=cv2.INTER_AREA) for f in frames)
    assert small.shape == (120, 160)
    assert overlap(cv2.resize(small.astype(np.uint8), (WIDTH, HEIGHT)) > 0, static_pixels(frames)) > 0.8
    with pytest.raises(ValueError, match=r"one size, got \[\(120, 640\), \(480, 640\)\]"):
        static_pixels([frames[0], frames[1][:120]])
    with pytest.raises(ValueError, match="got none"):
        static_pixels([])


def test_spread_is_uneven_and_leaves_out_where_the_robot_stands():
    travelled = np.concatenate([np.zeros(200), np.linspace(0, 8, 160), np.full(300, 8.0)])
    chosen = spread(travelled)
    assert 28 <= len(chosen) <= 32 and chosen.min() >= 199 and chosen.max() <= 360
    assert len(np.unique(np.diff(chosen))) > 3
    np.testing.assert_array_equal(spread(np.arange(5)), np.unique(spread(np.arange(5))))
    assert spread(np.arange(1)).tolist() == [0]


@pytest.mark.parametrize("name", ["corridor_rgbd/rgb", "logs/phone_corridors/f04_hallway_main", "rgbd_kitchen/rgb"])
def test_recorded_runs_keep_their_floor(data, name):
    paths = list_images(data(name))
    images = [read_image(paths[i]) for i in spread(np.arange(len(paths)))]
    assert not static_pixels(images).any()
    body = np.arange(images[0].shape[0])[:, None] * np.ones(images[0].shape[1]) >= 0.65 * images[0].shape[0]
    rng = np.random.default_rng(0)
    texture = cv2.resize(rng.integers(0, 255, (60, 80, 3), np.uint8), images[0].shape[1::-1])
    for image in images:
        image[body] = texture[body]
    assert overlap(static_pixels(images), body) > 0.9


@pytest.mark.parametrize("height_m", [0.2, 0.54, 1.2])
def test_a_view_without_ignored_pixels(height_m):
    camera = camera_over_floor(615.0, 615.0, 320.0, 240.0, WIDTH, HEIGHT, height_m, np.radians(25.0))
    view = from_camera(camera, choose_floor(camera, 0.01))
    ignored = lowest(0.3)
    ignored[100:300, 300:303] = True
    rest = without(view, camera, ignored)
    y, x = np.nonzero(np.asarray(rest.seen))
    assert 0 < len(x) < np.asarray(view.seen).sum() and not (rest.seen & ~view.seen).any()
    np.testing.assert_array_equal(rest.image_from_view, view.image_from_view)
    # Every corner of what is left keeps its distance from every ignored pixel, and what keeps more is left.
    distance = cv2.distanceTransform((~ignored).astype(np.uint8), cv2.DIST_C, 3)
    for dx, dy in (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5):
        u, v = np.rint(apply(view.image_from_view, np.stack([x + dx, y + dy], 1))).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < WIDTH) & (v < HEIGHT)
        assert distance[v[inside], u[inside]].min() > 2
    y, x = np.nonzero(np.asarray(view.seen & ~rest.seen))
    u, v = np.rint(apply(view.image_from_view, np.stack([x, y], 1).astype(float))).astype(int).T
    assert np.percentile(distance[v, u], 99) < 12
    np.testing.assert_array_equal(without(view, camera, np.zeros_like(ignored)).seen, view.seen)


def test_a_mask_that_leaves_no_view_is_refused():
    camera = camera_over_floor(615.0, 615.0, 320.0, 240.0, WIDTH, HEIGHT, 0.54, np.radians(19.0))
    with pytest.raises(
        ValueError, match=r"the mask leaves \d\.\d% of the floor view, at least 10% is needed; .*--quad$"
    ):
        without(from_camera(camera, choose_floor(camera, 0.01)), camera, lowest(0.9))
