import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from scipy.ndimage import gaussian_filter

from ebjax.features.extractor import extractor
from ebjax.features.matching import mutual_nearest
from ebjax.models.alike import ALIKE, VARIANTS
from ebjax.models.catalogue import MODELS, resolve
from ebjax.models.locate import locate
from ebjax.models.seeded import seeded_state
from ebjax.models.weights import flat_arrays, save_weights

NETWORKS = ["superpoint", "d2net", "alike"]


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Stand-in weights of every network in one folder."""
    folder = tmp_path_factory.mktemp("weights")
    for name in NETWORKS:
        if name == "alike":
            arrays = flat_arrays(ALIKE(*VARIANTS["alike-t"], rngs=nnx.Rngs(0)))
        else:
            arrays = resolve(MODELS[name].convert)(seeded_state(name, 2))
        save_weights(folder / f"{name}.safetensors", name, {key: np.asarray(array) for key, array in arrays.items()})
    return folder


def texture(size, seed=0):
    noise = np.random.default_rng(seed)
    layers = sum(s * gaussian_filter(noise.standard_normal((*size, 3)), (s, s, 0)) for s in (1.0, 3.0))
    return jnp.asarray(np.clip(0.5 + 0.2 * layers / layers.std(), 0, 1), jnp.float32)


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_a_turned_and_shifted_view_is_found_by_looking_again(weights, name):
    chosen, floor = extractor(name, weights), texture((224, 256))
    one, two = floor[:192, :224], floor[32:, 32:][::-1, ::-1]  # 192 x 224, shift 32
    seen = np.ones((192, 224), bool)
    seen[:40, :40] = False
    a, b = chosen.extract(one, jnp.asarray(seen)), chosen.turned(two, jnp.ones((192, 224), bool))
    assert a.keypoints.shape == b.keypoints.shape and a.valid.sum() > 30
    np.testing.assert_allclose(jnp.linalg.norm(a.descriptors[a.valid], axis=1), 1, atol=1e-4)
    points = np.asarray(a.keypoints)[np.asarray(a.valid)]
    assert not (points < 47).all(1).any() and points.min() > 7.5
    found = mutual_nearest(a, b, keep=100)
    rows = np.asarray(found.valid)
    unturned = np.array([223.0, 191.0]) - np.asarray(b.keypoints)[np.asarray(found.reference)]
    error = np.linalg.norm(np.asarray(a.keypoints)[np.asarray(found.query)] - 32 - unturned, axis=1)[rows]
    assert np.mean(error < 2) > 0.6 and np.median(error) < 0.5
    # Without looking again the network does not recognise the floor.
    blind = mutual_nearest(a, chosen.extract(two, jnp.ones((192, 224), bool)), keep=100)
    unturned = np.array([223.0, 191.0]) - np.asarray(b.keypoints)[np.asarray(blind.reference)]
    error = np.linalg.norm(np.asarray(a.keypoints)[np.asarray(blind.query)] - 32 - unturned, axis=1)
    assert np.mean(error[np.asarray(blind.valid)] < 2) < 0.3


@pytest.mark.slow
def test_keypoints_of_a_large_view_are_in_its_own_pixels(weights):
    chosen, small = extractor("d2net", weights), texture((400, 408))
    large = jnp.repeat(jnp.repeat(small, 2, 0), 2, 1)
    a, b = (chosen.extract(view, jnp.ones(view.shape[:2], bool)) for view in (small, large))
    np.testing.assert_allclose(b.keypoints, 2 * a.keypoints + 0.5, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_what_is_not_seen_does_not_matter(weights, name):
    chosen, floor, seen = extractor(name, weights), texture((192, 224)), np.zeros((192, 224), bool)
    seen[20:150, 30:190] = True
    mask = jnp.asarray(seen)[..., None]
    one, two = (
        chosen.extract(jnp.where(mask, floor, beyond), mask[..., 0]) for beyond in (0.0, texture((192, 224), 5))
    )
    np.testing.assert_array_equal(one.valid, two.valid)
    np.testing.assert_array_equal(one.keypoints[one.valid], two.keypoints[one.valid])
    assert one.valid.any()
    points = np.asarray(one.keypoints)[np.asarray(one.valid)]
    assert (points > [37, 27]).all() and (points < [182, 142]).all()


def test_networks_refuse_without_their_weights(weights, tmp_path, monkeypatch):
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    for name in NETWORKS:
        with pytest.raises(ValueError, match=rf"^{name} needs weights, and .*python -m ebjax.models convert .*{name}"):
            extractor(name)
    with pytest.raises(ValueError, match=r"weights of d2net, not of alike"):
        extractor("alike", weights / "d2net.safetensors")
    monkeypatch.setenv("EBJAX_WEIGHTS", str(weights))
    assert locate("alike") == weights / "alike.safetensors" == locate("alike", weights)
    assert locate("alike", weights / "d2net.safetensors") == weights / "d2net.safetensors"
    monkeypatch.delenv("EBJAX_WEIGHTS")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(ValueError, match=str(tmp_path / "ebjax" / "weights" / "d2net.safetensors")):
        locate("d2net")


@pytest.mark.slow
def test_winograd_finds_the_same(weights):
    floor, seen = texture((192, 224)), jnp.ones((192, 224), bool)
    exact, fast = (extractor("superpoint", weights, way).extract(floor, seen) for way in ("exact", "winograd"))
    np.testing.assert_array_equal(exact.valid, fast.valid)
    close = np.abs(np.asarray(exact.keypoints - fast.keypoints)[np.asarray(exact.valid)]).max(1) < 1e-3
    assert close.mean() > 0.95  # equal to rounding, which may swap equal scores
    np.testing.assert_allclose(exact.descriptors[exact.valid][close], fast.descriptors[fast.valid][close], atol=1e-3)
