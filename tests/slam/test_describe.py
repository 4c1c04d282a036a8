import cv2
import jax
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
from ebjax.slam.look import Looked
from ebjax.slam.packed import floor_of, landmarks_of, packed, view_of
from ebjax.slam.store import InMemory
from ebjax.views.floor_view import view_taps
from ebjax.views.run_view import from_camera

AGAIN = Extractor(jax.jit(ROOTSIFT.extract), jitted=False, turn=None)
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
    return view, camera, described


def jax_stack(rows):
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *rows)


@pytest.mark.slow
def test_turned_landmarks_lie_where_the_floor_has_them(frames):
    view, _, described = frames
    assert described["exact"].turned is None
    turned = described["again"].turned
    for k in range(2):
        points = apply(view.floor_from_view, jnp.asarray(turned.features.keypoints[k], jnp.float64))
        np.testing.assert_allclose(turned.floor_points[k], points, atol=1e-5)


def test_facing_rows_are_turned_and_the_others_are_not(frames):
    view, camera, described = frames
    straight, exact, again = [], [], []
    for name, chosen in (("exact", ROOTSIFT), ("again", AGAIN)):
        store = InMemory()
        for k in range(2):
            store.keep(packed(jax.tree.map(lambda leaf, k=k: leaf[k], described[name])))
        looked = Looked(store, view, camera, chosen.turn, 0.02, 0)
        for row in range(2):
            straight.append(looked.landmarks(row).features)
            (exact if chosen is ROOTSIFT else again).append(looked.landmarks(row, True).features)
    assert np.abs(exact[1].descriptors - straight[1].descriptors).max() > 0.1
    # Looking again finds nearly the same corners, and describes them as the exact turn does.
    for one, two in zip(exact, again, strict=True):
        found = mutual_nearest(one, two, keep=len(one.valid))
        pairs = np.asarray(found.valid)
        apart = np.abs(one.keypoints[found.query] - two.keypoints[found.reference]).max(1)[pairs]
        assert pairs.sum() > 30 and np.median(apart) < 0.1


def test_what_is_kept_says_the_same_again(frames):
    view, camera, described = frames
    one = jax.tree.map(lambda leaf: leaf[0], described["exact"])
    kept = packed(one)
    assert sum(np.asarray(value).nbytes for value in kept.values()) < 150_000
    again = landmarks_of(kept, view, camera, ROOTSIFT.turn, False)
    valid = np.asarray(one.landmarks.features.valid)
    count = int(valid.sum())
    assert int(again.features.valid.sum()) == count and bool(again.features.valid[:count].all())
    np.testing.assert_array_equal(again.grey, one.landmarks.grey)
    np.testing.assert_array_equal(floor_of(kept), one.floor)
    # JPEG halves the resolution of colours, not of the grey.
    greys = (cv2.cvtColor(view, cv2.COLOR_RGB2GRAY).astype(int) for view in (view_of(kept), np.asarray(one.view)))
    assert np.abs(np.subtract(*greys)).mean() < 2
    np.testing.assert_array_equal(again.features.keypoints[:count], one.landmarks.features.keypoints[valid])
    np.testing.assert_allclose(again.floor_points[:count], one.landmarks.floor_points[valid], atol=1e-6)
    np.testing.assert_allclose(again.pixels[:count], one.landmarks.pixels[valid], atol=1e-3)
    similar = np.sum(np.asarray(again.features.descriptors[:count]) * one.landmarks.features.descriptors[valid], 1)
    assert similar.min() > 0.99
