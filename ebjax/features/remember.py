"""Local features that are looked up before they are computed."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp

from ebjax.features.extractor import Extractor
from ebjax.features.matching import Features


def remembered(chosen: Extractor, remember: Callable[[Callable], Callable]) -> Extractor:
    """The same local feature.

    Args:
      chosen: what finds it.
      remember: a function of arrays that gives arrays by name -> one that knows what it has seen, as `Cache.remember`.
    """
    find = jax.jit(chosen.extract) if chosen.jitted else chosen.extract
    recall = remember(lambda view, seen: vars(find(view, seen)))

    def extract(view, seen) -> Features:
        return Features(**{name: jnp.asarray(array) for name, array in recall(view, seen).items()})

    return dataclasses.replace(chosen, extract=extract, jitted=False)
