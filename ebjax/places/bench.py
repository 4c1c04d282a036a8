"""Times the exhaustive search for the nearest descriptors against faiss and NumPy, turn by turn in one run.

A turn is one call of everyone; a figure is the median over turns, a ratio that of the medians. Descriptors are random
and of unit length, in memory before the clock starts; compilation and faiss' copy of the references are left out.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from ebjax.places.retrieve import cosine_top_k

CONTENDERS = ("ebjax", "faiss", "NumPy")


@dataclass(frozen=True)
class Row:
    """One line of the table: medians in ms, and the share of ebjax's answers that the others have too."""

    ms: dict[str, float]
    same: float


def top_k_by_numpy(
    queries: Float[np.ndarray, "Q V"], references: Float[np.ndarray, "N V"], k: int
) -> Integer[np.ndarray, "Q k"]:
    """The plain way: all products, the k best by partition, those sorted."""
    scores = (references @ queries[0])[None] if len(queries) == 1 else queries @ references.T
    best = np.argpartition(scores, -k, axis=1)[:, -k:]
    order = np.argsort(-np.take_along_axis(scores, best, 1), axis=1, kind="stable")
    return np.take_along_axis(best, order, 1)


def contenders(
    queries: Float[np.ndarray, "Q V"], references: Float[np.ndarray, "N V"], k: int
) -> dict[str, Callable[[], Any]]:
    """Everyone that is installed; each call gives the indices."""
    ours = jnp.asarray(queries), jnp.asarray(references)
    found: dict[str, Callable[[], Any]] = {
        "ebjax": lambda: jax.block_until_ready(cosine_top_k(*ours, k=k))[1],
        "NumPy": lambda: top_k_by_numpy(queries, references, k),
    }
    try:
        import faiss
    except ImportError:
        return found
    index = faiss.IndexFlatIP(references.shape[1])
    index.add(references)
    return found | {"faiss": lambda: index.search(queries, k)[1]}


def bench(references: int, queries: int, length: int, top: int, turns: int, seed: int) -> Row:
    """Searches `top` of so many references for so many queries of `length` numbers, `turns` times."""
    rng = np.random.default_rng(seed)
    theirs, ours = (rng.standard_normal((n, length), np.float32) for n in (references, queries))
    for vectors in (theirs, ours):
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    calls = contenders(ours, theirs, min(top, references))
    answers = {name: np.asarray(call()) for name, call in calls.items()}
    spent: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(turns):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            spent[name].append(1e3 * (time.perf_counter() - start))
    mine = answers.pop("ebjax")
    same = [len(set(a) & set(b)) / len(a) for other in answers.values() for a, b in zip(mine, other, strict=True)]
    return Row({name: float(np.median(times)) for name, times in spent.items()}, float(np.mean(same)))
