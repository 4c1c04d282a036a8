"""Processor time of parts and of their references, turn by turn, in a process of its own on one core.

A turn is some calls of every part and of its reference, in random order. What else the machine does comes and goes over
seconds, so the turns of a part are spread over the whole time.

Processor time, of all threads, leaves out the waiting for a core that others hold; the clock on the wall does not, and
differs most where one side has more threads. On one core no thread waits for another either, which OpenMP's do by
spinning. What is lost by this: time that grows because work no longer runs side by side is not seen.
"""

import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Float

from ebjax.bench.parts import PARTS, Pair
from ebjax.bench.turns import in_turn
from ebjax.command import progress, setup_jax


class Measured(NamedTuple):
    """Of every turn: processor time of a call in ms, ours and the reference's."""

    ours_ms: Float[np.ndarray, " T"]
    reference_ms: Float[np.ndarray, " T"]

    @property
    def ratios(self) -> Float[np.ndarray, " T"]:
        """Ours over the reference."""
        return self.ours_ms / self.reference_ms


def measure(names: Sequence[str], turns: int, slow_downs: Mapping[str, float]) -> dict[str, Measured]:
    """Parts of PARTS, by name.

    Args:
      names: of the parts.
      turns: how many.
      slow_downs: parts that are made to take so many times as long, to see whether that is noticed.
    """
    with one_core(), ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as alone:
        return alone.submit(_measure_here, names, turns, slow_downs).result()


def _measure_here(names: Sequence[str], turns: int, slow_downs: Mapping[str, float]) -> dict[str, Measured]:
    setup_jax()
    cv2.setNumThreads(1)
    pairs = {name: PARTS[name].make() for name in names}
    slowed_pairs = {
        name: pairs[name]._replace(ours=slowed(pairs[name].ours, times)) for name, times in slow_downs.items()
    }
    return timed(pairs | slowed_pairs, turns)


def timed(pairs: Mapping[str, Pair], turns: int) -> dict[str, Measured]:
    """Both sides of every pair."""
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in pairs}
    for turn in progress(range(turns), turns, "turns"):
        for name, (ours, reference, calls) in pairs.items():
            seconds = in_turn({"ours": ours, "reference": reference}, calls, clock=time.process_time, seed=turn)
            spent[name].append((seconds["ours"].mean(), seconds["reference"].mean()))
    return {name: Measured(*(1e3 * np.array(both).T)) for name, both in spent.items()}


def slowed(call: Callable[[], Any], times: float) -> Callable[[], Any]:
    """The call with idle work behind it, so that all takes so many times as long."""

    def longer() -> Any:
        start = time.process_time()
        answer = jax.block_until_ready(call())
        end = start + times * (time.process_time() - start)
        while time.process_time() < end:
            pass
        return answer

    return longer


@contextlib.contextmanager
def one_core() -> Iterator[None]:
    """Keeps processes that begin within to one core, where the system can (Linux)."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
