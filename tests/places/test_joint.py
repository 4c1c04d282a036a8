"""The joint descriptor where one of its parts says nothing, and on a real corridor with a carpet."""

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.io.image_folder import list_images
from ebjax.places import floornet, joint, rootsift_vlad
from ebjax.places.__main__ import Looker, PlacesConfig
from ebjax.places.descriptor import descriptor

RNG = np.random.default_rng(8)
PLACES = 12


@pytest.fixture(scope="module")
def looked(floor_texture):
    """What is kept of places seen twice, the second time with other light and noise; and of nothing but noise."""
    seen = jnp.ones((96, 96), bool)
    look = descriptor("joint").look

    def of(views):
        rgb = (np.repeat(view[..., None], 3, 2).astype(np.float32) for view in views)
        kept = [look(jnp.asarray(view), seen, np.rint(255 * view.clip(0, 1)).astype(np.uint8)) for view in rgb]
        return {name: np.stack([np.asarray(one[name]) for one in kept]) for name in kept[0]}

    places = [floor_texture((96, 96), 40 + k) for k in range(PLACES)]
    again = [0.8 * place + RNG.normal(0, 0.01, place.shape) for place in places]
    return of(places + again), of([0.5 + RNG.normal(0, 0.02, (96, 96)) for _ in range(2 * PLACES)])


def part(kept, which):
    """What one of the two parts makes of what was kept."""
    unite = {"floor": floornet, "whole": rootsift_vlad}[which].unite
    return unite({name: kept[f"{which}_{name}"] for name in ("map", "cells")})


def recall(vectors, margin=0):
    """The share of the second half's views whose best match in the first half is the same one, or `margin` off."""
    references, queries = np.split(np.asarray(vectors[..., 0]), 2)
    return np.mean(np.abs(np.argmax(queries @ references.T, 1) - np.arange(len(queries))) <= margin)


def mixed(first, second):
    """The floor of one, the whole images of the other."""
    return {name: (first if name.startswith("floor") else second)[name] for name in first}


@pytest.mark.slow
@pytest.mark.parametrize("informative", ["floor", "whole"])
def test_a_part_that_says_nothing_does_no_harm(looked, informative):
    some, none = looked
    kept = mixed(some, none) if informative == "floor" else mixed(none, some)
    alone = {which: recall(part(kept, which).vectors) for which in ("floor", "whole")}
    assert alone[informative] == 1 and min(alone.values()) < 0.5
    places = joint.unite(kept)
    assert recall(places.vectors) == 1
    assert (places.share > 0.8) if informative == "floor" else (places.share < 0.2)


@pytest.mark.slow
def test_the_whole_image_has_no_part_in_a_turned_view(looked):
    some, none = looked
    first, second = (np.asarray(joint.unite(kept).vectors) for kept in (some, mixed(some, none)))
    np.testing.assert_array_equal(first[..., 1], second[..., 1])
    floor = np.asarray(part(some, "floor").vectors)
    np.testing.assert_array_equal(first[:, : floor.shape[1], 1], floor[..., 1])


def test_distinctness_is_nothing_for_noise_and_grows_with_order():
    noise = RNG.standard_normal((200, 64))
    noise /= np.linalg.norm(noise, axis=1, keepdims=True)
    pairs = np.repeat(noise[:100], 2, 0) + 0.02 * noise
    few = noise @ np.diag([1.0, 1, 1, 1] + 60 * [0])
    few /= np.linalg.norm(few, axis=1, keepdims=True)
    weak, strong, crowded = (joint.distinctness(jnp.asarray(vectors)) for vectors in (noise, pairs, few))
    assert max(weak, crowded) < 0.02 * strong
    assert joint.distinctness(jnp.ones((5, 4)) / 2) == 0 == joint.distinctness(jnp.ones((2, 4)) / 2)
    assert joint.floor_share(jnp.ones((5, 4)) / 2, jnp.ones((5, 4)) / 2) == 0.5


def test_steady_are_views_that_match_one_after_another():
    """Places passed twice match in turn, noise does not."""
    passed = RNG.standard_normal((60, 64))
    twice = np.concatenate([passed, passed + 0.3 * RNG.standard_normal(passed.shape)])
    noise = RNG.standard_normal((2000, 64))
    assert joint.steadiness(jnp.asarray(twice)) > 0.95
    assert joint.steadiness(jnp.asarray(noise)) < 0.02
    assert joint.steadiness(jnp.asarray(passed[:5])) == 1


@pytest.mark.slow
def test_a_real_corridor_with_a_carpet(data):
    """A query's true references are its own number and two on either side. This floor says little, and does no harm."""
    folders = [data("vpr_corridor") / name for name in ("ref", "query")]
    quad = (66.0, 80.0, 92.0, 80.0, 112.0, 108.0, 46.0, 108.0)
    looker = Looker(PlacesConfig(*folders, quad=quad, quad_margin=0.15), descriptor("joint"))
    looked = [looker.look(path) for folder in folders for path in list_images(folder)]
    kept = {name: np.stack([one[name] for one in looked]) for name in looked[0]}
    floor, whole, both = (
        recall(places.vectors, margin=2) for places in (part(kept, "floor"), part(kept, "whole"), joint.unite(kept))
    )
    assert both >= whole > 0.7 > 0.3 > floor
