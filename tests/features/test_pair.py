import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.extractor import extractor
from ebjax.features.measure import SHARED_SIGMA, lift, measure_depth, measure_floor
from ebjax.features.pair import compare, extract, look, metric_view, quad_view, raw_view
from ebjax.geometry.camera import FloorView
from ebjax.geometry.homography import apply
from ebjax.models.luma import luma

FLOOR = FloorView(0.68, 2.43, -0.875, 0.875, 1.75 / 400)
SEEDS = 6


def test_quad_corners_are_the_corners_of_the_plane():
    quad = np.array([[144, 99], [345, 102], [430, 300], [50, 290.0]])
    for margin in (0.0, 0.25):
        view = quad_view(quad, 200, margin)
        assert view.size == (round(200 * (1 + 2 * margin)),) * 2
        plane = np.array([[0, 0], [200, 0], [200, 200], [0, 200.0]])
        at = apply(np.linalg.inv(view.plane_from_view), plane)
        np.testing.assert_allclose(apply(view.image_from_view, np.asarray(at)), quad, atol=1e-9)
        centre = (view.size[0] - 1) / 2  # R_pi about the view's centre is R_pi about the square's
        np.testing.assert_allclose(apply(view.plane_from_view, np.array([[centre, centre]])), [[100, 100]], atol=1e-9)


def test_fine_floor_is_averaged_not_aliased():
    """A checkerboard of single pixels, seen at a quarter of its resolution, is grey."""
    checker = np.indices((400, 400)).sum(0) % 2 * 255
    image = np.repeat(checker[..., None], 3, 2).astype(np.uint8)
    view, seen = look(image, quad_view(np.array([[20, 20], [380, 20], [380, 380], [20, 380.0]]), 90, 0.0))
    assert seen.all() and view.dtype == jnp.float32
    np.testing.assert_allclose(view, 0.5, atol=0.08)


def test_raw_view_is_the_image():
    image = np.random.default_rng(0).integers(0, 256, (40, 50, 3), np.uint8)
    view, seen = look(image, raw_view(50, 40))
    np.testing.assert_allclose(view, image / 255, atol=1e-6)
    np.testing.assert_allclose(luma(view), image @ np.array([0.299, 0.587, 0.114]) / 255, atol=1e-6)
    assert seen.all()


@pytest.fixture(scope="module")
def measured(scene):
    """Errors (x, y, theta) and covariances of both measurements over image and depth noise."""
    chosen, view = extractor("rootsift"), None
    found: dict = {"floor": [], "depth": []}
    for seed in range(SEEDS):
        made = scene(noise_seed=seed)
        view = metric_view(made.camera, FLOOR)
        a, b = (extract(chosen, image, view, turned=k == 1) for k, image in enumerate(made.images))
        pair = compare(a, b, view, model="rigid", tolerance=0.01)
        assert pair.believed and pair.inliers > 100
        q, r, inliers = pair.matched.query, pair.matched.reference, pair.matched.inliers
        found["floor"].append(measure_floor(pair.plane[0][q], pair.plane[1][r], inliers))
        (pa, ra), (pb, rb) = (
            lift(p, jnp.asarray(d, p.dtype), made.camera)
            for p, d in zip((pair.pixels[0][q], pair.pixels[1][r]), made.depths, strict=True)
        )
        found["depth"].append(measure_depth(pa, pb, inliers & (ra > 0) & (rb > 0), jnp.maximum(ra, rb)))
    return {way: jax.tree.map(lambda *leaves: np.stack(leaves), *results) for way, results in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("way", ["floor", "depth"])
def test_opposing_views_are_measured_to_millimetres_as_certainly_as_they_say(measured, a_from_b, way):
    error = measured[way].i_from_j - a_from_b[None]
    error[:, 2] = np.mod(error[:, 2] + np.pi, 2 * np.pi) - np.pi
    assert np.abs(error[:, :2]).max() < 0.003 and np.abs(error[:, 2]).max() < np.radians(0.15)
    # Without the shared part, which stands for errors that this scene does not have. The axes nearly coincide (-x, -y).
    variance = np.diagonal(measured[way].covariance, axis1=1, axis2=2).mean(0) - np.square(SHARED_SIGMA)
    ratio = np.sqrt(variance / np.mean(error**2, axis=0))
    assert (ratio > 1 / 3).all() and (ratio < 4).all()


@pytest.mark.slow
def test_another_floor_is_not_believed(scene):
    one, other = scene(seed=0), scene(seed=9)
    view, chosen = metric_view(one.camera, FLOOR), extractor("rootsift")
    a = extract(chosen, one.images[0], view)
    for turned in (False, True):
        b = extract(chosen, other.images[1], view, turned=turned)
        found = compare(a, b, view, model="rigid", tolerance=0.01)
        assert not found.believed and found.inliers < 15
