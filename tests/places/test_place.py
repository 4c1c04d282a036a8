"""Places of single views: turned views, unseen cells, other descriptors, words for other weights."""

import dataclasses
import shutil

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.models.floornet import SHIPPED, parity
from ebjax.places.descriptor import DESCRIPTORS
from ebjax.places.descriptor_map import rotate_pi_dense
from ebjax.places.fixed_words import NAMES, fixed_words, save_words, words_path
from ebjax.places.place import WITHOUT, place_of, placing, turned, turned_map

CHANNELS = {"floornet": 64, "rootsift-vlad": 256}


def kept(name, seed=0, size=(11, 12)):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((*size, CHANNELS[name])).astype(np.float32) / 8
    return {"map": values.astype(np.float16), "cells": rng.random(size) < 0.8}


def turned_over(name, one):
    if name == "floornet":
        values = one["map"][::-1, ::-1] * parity(64).astype(np.float16)
    else:
        values = np.asarray(rotate_pi_dense(jnp.asarray(one["map"])))
    return {"map": values, "cells": one["cells"][::-1, ::-1]}


def cosine(a, b):
    a, b = a.astype(float), b.astype(float)
    return a @ b / np.linalg.norm(a) / np.linalg.norm(b)


@pytest.mark.parametrize("name", NAMES)
def test_shipped_words_are_closed_and_small(name):
    words = fixed_words(name)
    assert set(np.unique(words.parity)) == {-1, 1} and words.words.shape == (64, 32)
    np.testing.assert_allclose(words.basis.T @ words.basis, np.eye(32), atol=1e-5)
    assert words_path(name, SHIPPED.parents[1] / "places").stat().st_size < 100_000
    assert words.version.startswith("1-") and "128 words of 32 channels" in repr(words)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("seed", "size"), [(0, (11, 12)), (1, (25, 25)), (2, (4, 9))])
def test_a_turned_view_is_a_signed_permutation(name, seed, size):
    words, one = fixed_words(name), kept(name, seed, size)
    place, other = place_of(one, words), place_of(turned_over(name, one), words)
    assert place.vector.shape == (4096,) and place.vector.dtype == place.map.dtype == np.int8
    # Sums run in another order: one step of eight bits at most, and rarely.
    for ours, theirs in (
        (place.turned, other.vector),
        (turned_map(place.map, words), other.map),
        (place.weight[::-1, ::-1], other.weight),
    ):
        apart = np.abs(ours.astype(int) - theirs.astype(int))
        assert apart.max() <= 1 and (apart > 0).mean() < 0.01
    np.testing.assert_array_equal(turned(place.turned, words), place.vector)
    np.testing.assert_array_equal(place.weight > 0, one["cells"])
    assert not place.map[~one["cells"]].any()


@pytest.mark.parametrize("name", NAMES)
def test_the_map_is_that_of_the_view_in_eight_bits(name):
    words, one = fixed_words(name), kept(name)
    place = place_of(one, words)
    expected = (one["map"].astype(np.float32) - words.mean) @ words.basis * one["cells"][..., None]
    np.testing.assert_allclose(place.scale * place.map, expected, atol=0.51 * place.scale)
    assert np.abs(place.map.astype(int)).max() == 127


def test_unseen_cells_do_not_count():
    words, one = fixed_words("floornet"), kept("floornet")
    painted = {**one, "map": np.where(one["cells"][..., None], one["map"], np.float16(3))}
    for ours, theirs in zip(place_of(one, words), place_of(painted, words), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    nothing = place_of({**one, "cells": np.zeros_like(one["cells"])}, words)
    assert not nothing.map.any() and not nothing.weight.any()


def test_places_do_not_depend_on_the_views_before():
    words = fixed_words("floornet")
    alone = [place_of(kept("floornet", seed), words) for seed in range(3)]
    again = [place_of(kept("floornet", seed), words) for seed in (2, 1, 0)][::-1]
    for ours, theirs in zip(alone, again, strict=True):
        np.testing.assert_array_equal(ours.vector, theirs.vector)


def test_floor_and_image_are_half_of_joint_each():
    floor, whole = kept("floornet"), kept("rootsift-vlad", 1)
    both = {f"floor_{k}": v for k, v in floor.items()} | {f"whole_{k}": v for k, v in whole.items()}
    place = placing("joint")(both)
    image = kept("rootsift-vlad", 2)
    other = placing("joint")({**both, **{f"whole_{k}": v for k, v in image.items()}})
    images = [placing("rootsift-vlad")(one).vector for one in (whole, image)]
    assert cosine(place.vector, other.vector) == pytest.approx(0.5 + 0.5 * cosine(*images), abs=1e-3)
    straight = placing("floornet")(floor)
    assert cosine(place.turned[:4096], straight.turned) > 0.999 and not place.turned[4096:].any()
    np.testing.assert_array_equal(place.map, straight.map)


def test_other_descriptors_are_compared_as_they_are():
    rng = np.random.default_rng(0)
    vectors = rng.standard_normal((2, 300)).astype(np.float32)
    place = placing("netvlad")({"vectors": vectors})
    assert cosine(place.vector, vectors[0]) > 0.9999 and cosine(place.turned, vectors[1]) > 0.9999
    blocks = rng.random((4, 5, 36)).astype(np.float32)
    place = placing("hog")({"blocks": blocks})
    assert cosine(place.vector, blocks.reshape(-1)) > 0.999 and place.map is None
    maps, cells = rng.random((2, 3, 3, 8)).astype(np.float16), np.ones((2, 3, 3), bool)
    cells[1, 0] = False
    place = placing("resnet50")({"map": maps, "cells": cells})
    assert cosine(place.vector, maps[0].reshape(-1)) > 0.999 and not place.turned.reshape(3, 3, 8)[0].any()


@pytest.mark.parametrize("name", [*WITHOUT, "sift"])
def test_descriptors_without_a_place_are_refused_with_those_that_have_one(name):
    with pytest.raises(ValueError, match=f"{name}.*these do: floornet, rootsift-vlad, hog, joint, netvlad"):
        placing(name)


def test_every_other_descriptor_has_one():
    assert all(callable(placing(name)) for name in DESCRIPTORS if name not in WITHOUT)


@pytest.mark.parametrize("name", ["hog", "joint", "netvlad"])
def test_only_two_have_words(name):
    with pytest.raises(ValueError, match="no fixed words; these have: floornet, rootsift-vlad"):
        fixed_words(name)


def test_maps_of_another_descriptor_are_refused():
    with pytest.raises(ValueError, match="maps of 256 channels: the words of floornet were learned from 64"):
        place_of(kept("rootsift-vlad"), fixed_words("floornet"))


def other_weights(folder):
    """The shipped ones with one byte changed in the last weight."""
    file = folder / "floornet.safetensors"
    data = bytearray(SHIPPED.read_bytes())
    data[-1] ^= 1
    file.write_bytes(bytes(data))
    return file


def test_words_of_other_weights_lie_beside_them(tmp_path):
    file, shipped = other_weights(tmp_path), fixed_words("floornet")
    with pytest.raises(ValueError, match=f"no words for these weights.*--weights {file} --out {tmp_path}"):
        fixed_words("floornet", file)
    arrays = {field.name: getattr(shipped, field.name) for field in dataclasses.fields(shipped)}
    save_words(words_path("floornet", tmp_path), "floornet", arrays, file)
    words = fixed_words("floornet", file)
    np.testing.assert_array_equal(words.words, shipped.words)
    assert words.version != shipped.version
    save_words(words_path("floornet", tmp_path), "floornet", arrays, SHIPPED)
    with pytest.raises(ValueError, match="belong to other weights"):
        fixed_words("floornet", file)


def test_damaged_words_are_named(tmp_path):
    file = other_weights(tmp_path)
    beside = words_path("floornet", tmp_path)
    beside.write_bytes(b"no words")
    with pytest.raises(ValueError, match=f"{beside}: not a whole safetensors file"):
        fixed_words("floornet", file)
    shutil.copy(SHIPPED, beside)
    with pytest.raises(ValueError, match="belong to other weights"):
        fixed_words("floornet", file)
