import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.geometry import lens_inverse
from ebjax.geometry.camera import camera_over_floor, ideal_from_raw, raw_from_ideal, raw_slopes
from ebjax.geometry.lens import bend as bend_step_by_step
from ebjax.geometry.lens import domain, lens

TERMS = [-0.28, 0.07, 1e-3, -2e-3, 0.02, 0.05, -0.02, 0.004, 1e-3, 2e-3, -1e-3, 1e-3, 0.03, -0.02]
FISHEYE = [0.05, -0.01, 0.003, -0.0005]
LENSES = [
    *(("plumb_bob", TERMS[:count]) for count in (4, 5, 8, 12, 14)),
    ("rational_polynomial", [0.3, -0.1, 1e-3, 2e-3, 0.02, 0.35, -0.05, 0.01]),
    ("equidistant", FISHEYE),
    ("omnidirectional", [0.8, -0.1, 0.02, 1e-3, -1e-3]),
    ("omnidirectional", [1.6, 0.05, -0.01, 1e-3, 2e-3]),
]
bend, unbend = jax.jit(bend_step_by_step), jax.jit(lens_inverse.unbend)
F, CENTRE = 600.0, np.array([320.0, 240.0])


def rays_within(degrees, count=400, seed=0):
    random = np.random.default_rng(seed)
    angle, turn = np.radians(random.uniform(0, degrees, count)), random.uniform(0, 2 * np.pi, count)
    return np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], 1)


def named(case):
    return f"{case[0]} {len(case[1])}" if isinstance(case, tuple) else None


@pytest.mark.slow
@pytest.mark.parametrize("case", LENSES, ids=named)
def test_what_is_bent_is_unbent_to_a_billionth_of_a_pixel(case):
    glass = lens(*case)
    wide = 115 if case[0] in ("equidistant", "omnidirectional") else 60
    rays = np.concatenate([rays_within(wide), [[0, 0, 1.0]]])
    points, inside = bend(glass, jnp.asarray(rays))
    assert inside.all()
    back, shown = unbend(glass, points)
    assert shown.all()
    np.testing.assert_allclose(back, rays, atol=1e-12)
    again, _ = bend(glass, back)
    assert F * np.abs(again - points).max() < 1e-9


@pytest.mark.parametrize("case", LENSES[:7], ids=named)
def test_projection_is_opencv(case):
    rays = rays_within(80 if case[0] == "equidistant" else 60)
    zero, k = np.zeros(3), np.array([[F, 0, CENTRE[0]], [0, F, CENTRE[1]], [0, 0, 1]])
    if case[0] == "equidistant":
        expected = cv2.fisheye.projectPoints(rays[None], zero, zero, k, np.array(case[1]))[0][0]
    else:
        expected = cv2.projectPoints(rays, zero, zero, k, np.array(case[1]))[0][:, 0]
    points, _ = bend(lens(*case), jnp.asarray(rays))
    np.testing.assert_allclose(F * np.asarray(points) + CENTRE, expected, atol=1e-9)


@pytest.mark.parametrize("case", LENSES[7:], ids=named)
def test_projection_is_meis(case):
    rays = rays_within(115)
    xi, k1, k2, p1, p2 = case[1]
    x, y = (rays[:, :2] / (rays[:, 2:] + xi)).T
    r2 = x * x + y * y
    factor = 1 + k1 * r2 + k2 * r2**2
    expected = np.stack(
        [x * factor + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * factor + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)], 1
    )
    points, _ = bend(lens(*case), jnp.asarray(rays))
    np.testing.assert_allclose(points, expected, atol=1e-12)


def test_a_strong_barrel_folds_nothing_into_view():
    glass = lens("plumb_bob", [-0.28, 0.0, 0.0, 0.0])
    limit = float(domain(glass, np.float64))
    assert limit == pytest.approx((1 / 0.84) ** 0.5, abs=1e-9)
    rays = rays_within(89, 2000)
    points, inside = bend(glass, jnp.asarray(rays))
    radius = np.hypot(*(rays[:, :2] / rays[:, 2:]).T)
    np.testing.assert_array_equal(inside, radius <= limit)
    # Beyond, the formula leads back into the image: that is what must not be seen.
    assert (np.linalg.norm(points, axis=1)[~np.asarray(inside)] < 0.6).any()
    camera = camera_over_floor(F, F, *CENTRE, 640, 480, 0.5, 0.3)
    camera = camera.__class__(camera.intrinsics, camera.base_from_camera, 640, 480, glass)
    far = np.array([[CENTRE[0] + F * 1.5, CENTRE[1]], [CENTRE[0] + F * 0.5, CENTRE[1]]])
    raw = np.asarray(raw_from_ideal(camera, far))
    assert raw[0, 0] == -1e6 and 0 < raw[1, 0] < 640
    _, shown = unbend(glass, jnp.array([[0.9, 0.0], [0.3, 0.1]]))
    np.testing.assert_array_equal(shown, [False, True])


@pytest.mark.parametrize("case", LENSES, ids=named)
def test_behind_the_camera_nothing_is_seen(case):
    rays = np.array([[0.0, 0.0, -1.0], [1e-3, 0, -1.0], [0, 0, 0.0]])
    points, inside = bend(lens(*case), jnp.asarray(rays))
    assert np.isfinite(points).all() and not inside[:2].any()


def test_a_fisheye_sees_beyond_its_own_plane_and_not_beyond_its_fold():
    wide = lens("equidistant", FISHEYE)
    limit = float(domain(wide, np.float64))
    assert np.pi / 2 < limit < np.pi
    angle = np.array([np.pi / 2 + 0.3, limit - 1e-6, limit + 1e-6])
    _, inside = bend(wide, jnp.asarray(np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1)))
    np.testing.assert_array_equal(inside, [True, True, False])


@pytest.mark.slow
@pytest.mark.parametrize("case", LENSES, ids=named)
def test_derivatives_are_those_of_central_differences(case):
    glass = lens(*case)
    rays = jnp.asarray(np.concatenate([rays_within(50, 20), [[0, 0, 1.0]]]))
    points = bend(glass, rays)[0]
    random = np.random.default_rng(1)
    weights = jnp.asarray(random.normal(size=points.shape)), jnp.asarray(random.normal(size=rays.shape))

    def forward(coefficients, rays):
        return jnp.sum(weights[0] * bend(lens_of(coefficients), rays)[0])

    def backward(coefficients, points):
        return jnp.sum(weights[1] * unbend(lens_of(coefficients), points)[0])

    def lens_of(coefficients):
        return glass.__class__(coefficients, glass.model)

    k = jnp.asarray(glass.coefficients)
    for function, arguments in (forward, (k, rays)), (backward, (k, points)):
        function, gradients = jax.jit(function), jax.jit(jax.grad(function, (0, 1)))(*arguments)
        for n, gradient in enumerate(gradients):
            along = jnp.asarray(random.normal(size=gradient.shape))
            ends = [
                function(*(a + side * 1e-6 * along if m == n else a for m, a in enumerate(arguments)))
                for side in (1, -1)
            ]
            assert float(jnp.sum(gradient * along)) == pytest.approx(
                float(ends[0] - ends[1]) / 2e-6, rel=1e-6, abs=1e-7
            )


def test_ideal_and_raw_pixels_of_a_camera():
    camera = camera_over_floor(F, F, *CENTRE, 640, 480, 0.5, 0.3)
    straight = np.random.default_rng(0).uniform(0, 480, (50, 2))
    np.testing.assert_array_equal(raw_from_ideal(camera, straight), straight)
    camera = camera.__class__(camera.intrinsics, camera.base_from_camera, 640, 480, lens("equidistant", FISHEYE))
    ideal = ideal_from_raw(camera, straight)
    np.testing.assert_allclose(raw_from_ideal(camera, ideal), straight, atol=1e-9)
    step = 1e-4
    for axis in (0, 1):
        shift = np.zeros((1, 2))
        shift[0, axis] = step
        slope = (raw_from_ideal(camera, ideal + shift) - raw_from_ideal(camera, ideal - shift)) / (2 * step)
        np.testing.assert_allclose(raw_slopes(camera, ideal)[:, :, axis], slope, atol=1e-6)


@pytest.mark.parametrize(
    "model, count, words",
    [("fov", 1, "'fov' is no known distortion model; known are pinhole, "), ("plumb_bob", 3, "3 coefficients")],
)
def test_unknown_lenses_are_refused(model, count, words):
    with pytest.raises(ValueError, match=words):
        lens(model, [0.1] * count)
