"""Calls that are timed in turn, and what is sure of a median over turns.

A turn is one call of everyone, in random order: what else the machine does meets all of them alike. The interval is
that of order statistics: it asks nothing of how values are spread, and a few wild turns do not move it.
"""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.stats import binom

SHARE = 0.95
FEWEST = 6
"""Values whose median lies with that share between two of them."""


def in_turn(
    calls: Mapping[str, Callable[[], Any]],
    turns: int,
    *,
    clock: Callable[[], float] = time.perf_counter,
    seed: int = 0,
) -> dict[str, Float[np.ndarray, " T"]]:
    """Seconds of every call, turn by turn. Each is called once before that, which compiles and fills caches."""
    order, names = np.random.default_rng(seed), list(calls)
    spent: dict[str, list[float]] = {name: [] for name in names}
    for call in calls.values():
        jax.block_until_ready(call())
    for _ in range(turns):
        for k in order.permutation(len(names)):
            start = clock()
            jax.block_until_ready(calls[names[k]]())
            spent[names[k]].append(clock() - start)
    return {name: np.array(seconds) for name, seconds in spent.items()}


class Interval(NamedTuple):
    """A median, and between what the true one lies with a probability of at least SHARE."""

    low: float
    median: float
    high: float


def median_interval(values: Float[np.ndarray, " N"]) -> Interval:
    """Of independent values: their k-th smallest and k-th largest, k by the binomial distribution.

    Raises:
      ValueError: fewer than FEWEST values.
    """
    if len(values) < FEWEST:
        raise ValueError(f"{len(values)} values say too little of their median; give at least {FEWEST}")
    ordered = np.sort(values)
    k = int(binom.ppf((1 - SHARE) / 2, len(ordered), 0.5))
    return Interval(float(ordered[k - 1]), float(np.median(ordered)), float(ordered[-k]))
