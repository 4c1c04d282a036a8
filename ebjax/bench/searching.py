"""The exhaustive search for the nearest descriptors beside faiss and NumPy.

Descriptors are random and of unit length, in memory before the clock starts; compilation and faiss' copy of the
references are left out.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Integer

from ebjax.bench.turns import in_turn
from ebjax.places.retrieve import cosine_top_k

Search = Callable[[], Integer[np.ndarray, "Q k"]]


@dataclass(frozen=True)
class SearchConfig:
    """Times the exhaustive search for the nearest descriptors beside faiss and NumPy."""

    length: int = 4096
    """Of a descriptor."""
    top: int = 20
    """Descriptors that are looked for."""
    sizes: tuple[tuple[int, int], ...] = ((4096, 4096), (100_000, 100), (100_000, 1))
    """References and queries of each line."""
    turns: int = 5
    """How often everyone searches; the median counts."""
    seed: int = 0
    """Of the descriptors."""


def bench_search(config: SearchConfig) -> None:
    """Prints a table: ms, and the share of ebjax's answers that the others have too."""
    if min(config.length, config.top, config.turns, *(n for size in config.sizes for n in size)) < 1:
        raise ValueError("--length, --top, --sizes and --turns must be at least 1")
    names = ("ebjax", "faiss", "NumPy")
    print(f"{'references':>10} {'queries':>8} {'ebjax':>9} {'faiss':>9} {'NumPy':>9}   ms; same answers")
    for references, queries in config.sizes:
        searches = searches_of(references, queries, config.length, config.top, config.seed)
        answers = {name: np.asarray(search()) for name, search in searches.items()}
        ms = {name: 1e3 * float(np.median(s)) for name, s in in_turn(searches, config.turns).items()}
        times = "".join(f"{ms[name]:10.1f}" if name in ms else f"{'-':>10}" for name in names)
        print(f"{references:10} {queries:8}{times}   {same(answers):.4%}", flush=True)
    if "faiss" not in ms:
        print('faiss is not installed: pip install "ebjax[oracle]"')


def searches_of(references: int, queries: int, length: int, top: int, seed: int) -> dict[str, Search]:
    """Everyone that is installed, over `top` of so many references for so many queries of `length` numbers."""
    rng = np.random.default_rng(seed)
    theirs, ours = (rng.standard_normal((n, length), np.float32) for n in (references, queries))
    for vectors in (theirs, ours):
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    k, on_device = min(top, references), (jnp.asarray(ours), jnp.asarray(theirs))
    found: dict[str, Search] = {
        "ebjax": lambda: jax.block_until_ready(cosine_top_k(*on_device, k=k))[1],
        "NumPy": lambda: top_k_by_numpy(ours, theirs, k),
    }
    if importlib.util.find_spec("faiss") is None:
        return found
    import faiss

    index = faiss.IndexFlatIP(length)
    index.add(theirs)
    return found | {"faiss": lambda: index.search(ours, k)[1]}


def top_k_by_numpy(
    queries: Float[np.ndarray, "Q V"], references: Float[np.ndarray, "N V"], k: int
) -> Integer[np.ndarray, "Q k"]:
    """The plain way: all products, the k best by partition, those sorted."""
    scores = (references @ queries[0])[None] if len(queries) == 1 else queries @ references.T
    best = np.argpartition(scores, -k, axis=1)[:, -k:]
    order = np.argsort(-np.take_along_axis(scores, best, 1), axis=1, kind="stable")
    return np.take_along_axis(best, order, 1)


def same(answers: dict[str, Integer[np.ndarray, "Q k"]]) -> float:
    """The share of ebjax's answers that the others have too."""
    others = [answer for name, answer in answers.items() if name != "ebjax"]
    shares = [
        len(set(a) & set(b)) / len(a)
        for other in others
        for a, b in zip(answers["ebjax"].tolist(), other.tolist(), strict=True)
    ]
    return float(np.mean(shares))
