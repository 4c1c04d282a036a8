"""What every descriptor promises: unit vectors, R_pi, and that what is not seen does not matter."""

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.parts import _made
from ebjax.places.descriptor import DESCRIPTORS, descriptor

SIZE, VIEWS = 112, 4
IMAGE = np.full((8, 8, 3), 99, np.uint8)


@pytest.fixture(autouse=True)
def made_anew():
    """What is made here is of another size than in use."""
    _made.cache_clear()
    yield
    _made.cache_clear()


def coloured(floor_texture, seed):
    return np.stack([floor_texture((SIZE, SIZE), 3 * seed + k) for k in range(3)], -1)


def looked(chosen, views, seen):
    look = jax.jit(chosen.look) if chosen.jitted else chosen.look
    kept = [look(jnp.asarray(view), jnp.asarray(mask), IMAGE) for view, mask in zip(views, seen, strict=True)]
    return {name: np.stack([np.asarray(one[name]) for one in kept]) for name in kept[0]}


@pytest.mark.slow
@pytest.mark.parametrize("name", DESCRIPTORS)
def test_vectors_are_unit_turn_with_the_view_and_know_nothing_of_what_is_not_seen(
    weights, floor_texture, name, monkeypatch
):
    module = importlib.import_module(DESCRIPTORS[name].partition(":")[0])
    if hasattr(module, "SIDE_PX"):
        monkeypatch.setattr(module, "SIDE_PX", SIZE)  # as large as in use they take a minute
    chosen = descriptor(name, weights(name.removesuffix("-pooled")))
    views = [coloured(floor_texture, k) for k in range(VIEWS)]
    seen = np.ones((SIZE, SIZE), bool)
    seen[:40, :40] = False
    hidden = [np.where(seen[..., None], view, 0) for view in views]
    turned = [np.ascontiguousarray(view[::-1, ::-1]) for view in hidden]
    masks = [seen] * VIEWS + [seen[::-1, ::-1].copy()] * VIEWS
    kept = looked(chosen, hidden + turned, masks)
    painted = looked(chosen, [np.where(seen[..., None], view, 1) for view in views[:1]], masks[:1])
    for key in kept:
        np.testing.assert_allclose(painted[key][0], kept[key][0], atol=1e-3, err_msg=key)

    places = chosen.unite(kept, seed=1)
    vectors = np.asarray(places.vectors)
    assert vectors.shape[::2] == (2 * VIEWS, 2) and vectors.dtype == np.float32
    if name != "joint":  # half of its views' images say nothing here: they are all the same
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-4)
    # The run holds every view and its turned form: what is learned from it has no side.
    there, here = vectors[:VIEWS, :, 1], vectors[VIEWS:, :, 0]
    if name == "joint":  # whose whole image does not turn
        floor = slice(0, np.flatnonzero(there.any(0)).max() + 1)
        here = here[:, floor] / np.linalg.norm(here[:, floor], axis=1, keepdims=True)
        there = there[:, floor]
    scores = there @ here.T
    assert np.diag(scores).min() > 0.93
    assert (np.argmax(scores, 1) == np.arange(VIEWS)).all()
    np.testing.assert_array_equal(chosen.unite(kept, seed=1).vectors, vectors)


@pytest.mark.parametrize("name", sorted(set(DESCRIPTORS) - {"floornet", "rootsift-vlad", "hog", "joint"}))
def test_networks_refuse_without_their_weights(weights, tmp_path, monkeypatch, name):
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    network = name.removesuffix("-pooled")
    with pytest.raises(
        ValueError, match=rf"^{network} needs weights, and .*python -m ebjax.models convert .*{network}"
    ):
        descriptor(name)
    other = "superpoint" if network != "superpoint" else "resnet50"
    with pytest.raises(ValueError, match=f"weights of {other}, not of {network}"):
        descriptor(name, weights(other) / f"{other}.safetensors")


def test_unknown_names_are_told_the_known_ones():
    with pytest.raises(ValueError, match="choose one of floornet, rootsift-vlad, hog, joint"):
        descriptor("gist")
