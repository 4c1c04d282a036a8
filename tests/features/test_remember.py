"""Features from the cache are those that were found, on both sides, and a second look finds nothing anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ebjax.features.extractor import Extractor
from ebjax.features.opencv import SIFT
from ebjax.features.remember import remembered
from ebjax.features.upright import ROOTSIFT
from ebjax.io.cache import Cache


@pytest.mark.slow
@pytest.mark.parametrize("chosen", [ROOTSIFT, SIFT, Extractor(SIFT.extract, jitted=False, turn=None)])
def test_the_cache_gives_the_same_features(tmp_path, chosen):
    view = jnp.asarray(np.random.default_rng(0).uniform(size=(96, 128, 3)).astype(np.float32))
    seen, calls = jnp.ones((96, 128), bool), []

    def counted(view, seen):
        calls.append(1)
        return chosen.extract(view, seen)

    known = Extractor(counted, jitted=False, turn=chosen.turn)
    for _ in range(2):
        found = remembered(known, Cache(tmp_path, "sift", {}, shard_s=0).remember)
        for ours, theirs in ((found.extract, chosen.extract), (found.turned, chosen.turned)):
            theirs = jax.jit(theirs) if chosen.jitted else theirs
            for one, other in zip(*(jax.tree.leaves(find(view, seen)) for find in (ours, theirs)), strict=True):
                assert one.dtype == other.dtype
                np.testing.assert_allclose(one, other, atol=1e-4)
    assert len(calls) == (2 if chosen.turn is None else 1)
