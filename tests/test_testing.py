"""The checks of `ebjax.testing`: ours pass, and each broken promise is refused with its own reason."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from ebjax.features.extractor import Extractor
from ebjax.features.upright import ROOTSIFT
from ebjax.places.descriptor import Descriptor
from ebjax.testing import check_descriptor, check_extractor

WITHOUT_WEIGHTS = ("floornet", "rootsift-vlad", "hog", "joint")


def grid(view, seen):
    """Means of 12 x 12 cells, less their mean, where something is seen."""
    weight = seen.astype(view.dtype)
    grey, share = (jax.image.resize(one, (12, 12), "linear") for one in (view.mean(-1) * weight, weight))
    cells = jnp.where(share > 0.1, grey / jnp.maximum(share, 0.1), 0)
    return jnp.where(share > 0.1, cells - cells.sum() / jnp.maximum((share > 0.1).sum(), 1), 0)


def unit(cells):
    vector = cells.reshape(-1)
    return vector / jnp.sqrt(jnp.maximum(jnp.sum(vector**2), 1e-12))


def look(view, seen, image):
    cells = grid(view, seen)
    return {"vector": unit(cells), "turned": unit(cells[::-1, ::-1])}


def longer(view, seen, image):
    return {name: 2 * vector for name, vector in look(view, seen, image).items()}


def unturned(view, seen, image):
    return {name: unit(grid(view, seen)) for name in ("vector", "turned")}


def unmasked(view, seen, image):
    return look(view, jnp.ones_like(seen), image)


def divided(view, seen, image):
    cells = grid(view, seen)
    return {
        name: one.reshape(-1) / jnp.linalg.norm(one) for name, one in (("vector", cells), ("turned", cells[::-1, ::-1]))
    }


def growing(view, seen, image):
    return {name: vector[: 100 + int(seen.mean() > 0.9)] for name, vector in look(view, seen, image).items()}


def changing(view, seen, image):
    dtype = jnp.float32 if bool(seen.all()) else jnp.float16
    return {name: vector.astype(dtype) for name, vector in look(view, seen, image).items()}


def test_a_right_descriptor_passes():
    check_descriptor(Descriptor(look))


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (Descriptor(unturned), r"^R_pi: the turned vector of a view has a cosine of"),
        (Descriptor(longer), r"^norm: the vectors are 2 to 2 long; give unit vectors$"),
        (Descriptor(unmasked), r"^mask: look gives another '\w+' when what is not seen is painted white"),
        (Descriptor(divided), r"^NaN: look gives '\w+' with values that are not finite"),
        (
            Descriptor(growing, jitted=False),
            r"^shape: look gives 'vector' of shape \(100,\), of another view \(101,\)$",
        ),
        (Descriptor(changing, jitted=False), r"^dtype: look gives 'vector' of float16, of another view float32$"),
        (Descriptor(growing), r"^jitted: look cannot be called inside a jitted program; give jitted=False"),
        (Descriptor(lambda *_: {"map": jnp.zeros(3)}), r"^shape: look gives map; give 'vector' and 'turned'"),
    ],
)
def test_each_broken_promise_of_a_descriptor_has_its_reason(wrong, reason):
    with pytest.raises(AssertionError, match=reason):
        check_descriptor(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHOUT_WEIGHTS)
def test_our_descriptors_pass(name):
    check_descriptor(name)


def with_features(change):
    """rootSIFT, its features changed by a function of these and of what is seen."""

    def extract(view, seen):
        return change(ROOTSIFT.extract(view, seen), seen)

    return Extractor(extract, jitted=False, turn=ROOTSIFT.turn)


def everywhere(view, seen):
    return ROOTSIFT.extract(view, jnp.ones_like(seen))


replace = dataclasses.replace


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (replace(ROOTSIFT, turn=lambda descriptors: descriptors), r"^R_pi: \d+% of the features of a turned view"),
        (with_features(lambda f, _: replace(f, descriptors=2 * f.descriptors)), r"^norm: the descriptors are"),
        (replace(ROOTSIFT, extract=everywhere), r"^mask: extract gives a keypoint at .*, where nothing is seen$"),
        (
            with_features(lambda f, seen: replace(f, keypoints=f.keypoints / jnp.where(seen.any(), 1.0, 0.0))),
            r"^NaN: extract gives 'keypoints' with values that are not finite",
        ),
        (
            with_features(lambda f, _: jax.tree.map(lambda leaf: leaf[: 100 + int(f.valid.sum() > 50)], f)),
            r"^shape: extract gives 'keypoints' of shape \(101, 2\), of another view \(100, 2\)$",
        ),
        (
            with_features(
                lambda f, seen: replace(f, descriptors=f.descriptors.astype("float32" if seen.all() else "float16"))
            ),
            r"^dtype: extract gives 'descriptors' of float16, of another view float32$",
        ),
        (
            Extractor(lambda view, seen: (view, seen), False, None),
            r"^shape: extract gives a tuple; give ebjax.Features$",
        ),
    ],
)
def test_each_broken_promise_of_an_extractor_has_its_reason(wrong, reason):
    with pytest.raises(AssertionError, match=reason):
        check_extractor(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["floornet", "rootsift", "sift", "orb", "surf"])
def test_our_extractors_pass(name):
    check_extractor(name)
