"""A floor that wears on: every pass finds some marks more than the one before."""

import threading
from collections.abc import Callable
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from ebjax.floors import laying
from ebjax.floors.atlas import Atlas
from ebjax.floors.plan import Plan
from ebjax.floors.surface import FloorConfig


def floors_of(
    plan: Plan,
    config: FloorConfig,
    *,
    key: Key[Array, ""],
    photographs: Float[np.ndarray, "N n n 3"] | None = None,
) -> Callable[[int], Atlas]:
    """Number of a pass, from 0 -> the floor it drives over; safe to call from several threads.

    A pure function of the key, whatever was asked for before. The last two floors are kept, and the texture of the
    first and of the last: quick where passes are asked for in order.

    Args:
      plan: its corridors.
      config: the floor.
      key: of everything random.
      photographs: what the family "photograph" lays.
    """
    if config.ageing_per_m2 == 0:
        only = laying.floor_of(plan, config, key=key, photographs=photographs)
        return lambda number: only
    blocks = laying.blocks_of(plan, config.texel_m)
    first = laying.lay(blocks, config, key=key, photographs=photographs)
    worn, passed, lock = first.copy(), 0, threading.Lock()
    # The key itself lays the first floor; what it is split into there is not drawn from again.
    of_marks, of_places = jax.random.split(jax.random.fold_in(key, 1))

    def wear_on(number: int) -> None:
        place_key, mark_key = (jax.random.fold_in(k, number) for k in (of_places, of_marks))
        marks = laying.marks_on(plan, config, config.ageing_per_m2, key=place_key)
        paint = laying.painter(blocks, marks, config.wear, key=mark_key)
        for block in range(len(blocks.spans)):
            at = blocks.columns_of(block)
            worn[:, at] = np.asarray(paint(block, jnp.asarray(worn[:, at], jnp.float32)), np.float16)

    @lru_cache(maxsize=2)
    def made(number: int) -> Atlas:
        nonlocal passed
        if number < passed:
            worn[:], passed = first, 0
        while passed < number:
            passed += 1
            wear_on(passed)
        # Finished before `worn` changes again.
        return jax.block_until_ready(blocks.atlas(worn))

    def floor(number: int) -> Atlas:
        with lock:
            return made(number)

    return floor
