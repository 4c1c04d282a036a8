import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.features.extractor import Extractor
from ebjax.features.matching import mutual_nearest
from ebjax.features.upright import ROOTSIFT
from ebjax.geometry.camera import FloorView, camera_over_floor
from ebjax.geometry.homography import apply
from ebjax.slam.describe import describe
from ebjax.slam.verify import seen_from
from ebjax.views.floor_view import view_taps
from ebjax.views.run_view import from_camera

AGAIN = Extractor(ROOTSIFT.extract, jitted=False, turn=None)
"""As a network: of a turned view it has to look at the turned view."""


@pytest.fixture(scope="module")
def frames():
    """Two frames described, stacked as a run stacks them, by rootSIFT and by looking again."""
    camera = camera_over_floor(400.0, 400.0, 159.5, 119.5, 320, 240, 0.6, np.radians(35))
    view = from_camera(camera, FloorView(0.4, 1.2, -0.4, 0.4, 0.01))
    samples, described = view_taps(view, camera), {}
    for name, chosen in (("exact", ROOTSIFT), ("again", AGAIN)):
        both = []
        for seed in (0, 1):
            noise = gaussian_filter(np.random.default_rng(seed).standard_normal((240, 320, 3)), (2, 2, 0))
            rgb = np.clip(128 + 60 * noise / noise.std(), 0, 255).astype(np.uint8)
            both.append(describe(rgb, jnp.zeros((240, 320), jnp.float32), samples, view, camera, extractor=chosen))
        described[name] = jax_stack(both)
    return view, described


def jax_stack(rows):
    import jax

    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *rows)


def test_turned_landmarks_lie_where_the_floor_has_them(frames):
    view, described = frames
    assert described["exact"].turned is None
    turned = described["again"].turned
    for k in range(2):
        points = apply(view.floor_from_view, jnp.asarray(turned.features.keypoints[k], jnp.float64))
        np.testing.assert_allclose(turned.floor_points[k], points, atol=1e-5)


def test_facing_rows_are_turned_and_the_others_are_not(frames):
    _, described = frames
    rows, facing = np.array([0, 1, 1]), np.array([True, False, True])
    exact, again = (
        seen_from(described[name], chosen, rows, facing) for name, chosen in (("exact", ROOTSIFT), ("again", AGAIN))
    )
    straight = described["exact"].landmarks.features
    np.testing.assert_array_equal(exact.features.descriptors[1], straight.descriptors[1])
    assert np.abs(exact.features.descriptors[2] - straight.descriptors[1]).max() > 0.1
    # Looking again finds nearly the same corners, and describes them as the exact turn does.
    for k in range(3):
        one, two = (
            type(f)(*(jnp.asarray(leaf[k]) for leaf in (f.keypoints, f.descriptors, f.valid)))
            for f in (exact.features, again.features)
        )
        found = mutual_nearest(one, two, keep=len(one.valid))
        pairs = np.asarray(found.valid)
        apart = np.abs(one.keypoints[found.query] - two.keypoints[found.reference]).max(1)[pairs]
        assert pairs.sum() > 30 and np.median(apart) < 0.1
