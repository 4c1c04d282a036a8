import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ebjax.features.extractor import extractor
from ebjax.features.matching import Features, mutual_nearest
from ebjax.features.upright import octaves

CLASSICAL = ["rootsift", "sift", "orb", "surf"]


def texture(size=(200, 220), seed=0):
    noise = np.random.default_rng(seed)
    layers = sum(s * gaussian_filter(noise.standard_normal(size), s) for s in (1.5, 4.0))
    return np.clip(0.5 + 0.15 * layers / layers.std(), 0, 1).astype(np.float32)


def run(chosen, grey, seen, turned=False):
    view = jnp.repeat(jnp.asarray(grey)[..., None], 3, 2)
    function = chosen.turned if turned else chosen.extract
    return (jax.jit(function) if chosen.jitted else function)(view, jnp.asarray(seen))


@pytest.mark.parametrize("name", CLASSICAL)
def test_every_extractor_finds_a_turned_and_shifted_view(name):
    chosen, grey = extractor(name), texture((230, 250))
    one, two = grey[:200, :220], grey[30:, 30:][::-1, ::-1]  # size 200 x 220, shift 30
    seen = np.ones(one.shape, bool)
    seen[:40, :40] = False
    a, b = run(chosen, one, seen), run(chosen, two, np.ones(two.shape, bool), turned=True)
    assert isinstance(a, Features) and a.valid.sum() > 50
    np.testing.assert_allclose(np.linalg.norm(a.descriptors[a.valid], axis=1), 1, atol=2e-3)
    corner = (a.keypoints[a.valid] < 38).all(axis=1)
    assert not corner.any()
    found = mutual_nearest(a, b, keep=100)
    rows = np.asarray(found.valid)
    turned = np.array([219.0, 199.0]) - np.asarray(b.keypoints)[np.asarray(found.reference)]
    error = np.linalg.norm(np.asarray(a.keypoints)[np.asarray(found.query)] - 30 - turned, axis=1)[rows]
    # mahotas' SURF is not as distinctive as the others on this texture.
    assert np.mean(error < 2) > (0.3 if name == "surf" else 0.6) and np.median(error[error < 2]) < 1


@pytest.mark.parametrize("name", CLASSICAL)
def test_a_flat_view_has_no_features(name):
    grey, seen = np.full((80, 90), 0.5, np.float32), np.ones((80, 90), bool)
    assert not run(extractor(name), grey, seen).valid.any()


def test_unknown_extractor_lists_the_known():
    with pytest.raises(
        ValueError, match=r"'freak' is unknown; choose one of floornet, rootsift, sift, orb, surf, superpoint"
    ):
        extractor("freak")


def test_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mahotas.features.surf", None)
    monkeypatch.delitem(sys.modules, "ebjax.features.surf", raising=False)
    with pytest.raises(ValueError, match=r'^surf needs mahotas.*: pip install "ebjax\[surf\]"$'):
        extractor("surf")


def test_large_views_are_described_at_more_scales():
    assert [octaves(*size) for size in ((120, 300), (200, 200), (399, 500), (400, 400), (800, 900))] == [1, 1, 1, 2, 3]
    chosen, grey = extractor("rootsift"), texture((404, 420))
    a = run(chosen, grey, np.ones(grey.shape, bool))
    # A shift by a multiple of the coarsest pixel leaves every octave's keypoints where they are on the floor.
    b = run(chosen, np.roll(grey, (8, 8), (0, 1)), np.ones(grey.shape, bool))
    found = mutual_nearest(a, b, keep=len(a.valid))
    shift = np.asarray(b.keypoints)[np.asarray(found.reference)] - np.asarray(a.keypoints)[np.asarray(found.query)]
    coarse = np.asarray(found.valid) & (np.asarray(found.query) >= len(a.valid) // 2)
    assert coarse.sum() > 100
    np.testing.assert_allclose(np.median(shift[coarse], axis=0), 8, atol=1e-3)
