"""Retrieval on the floor views of a run, as they are and corrupted: every view by itself, queries and references alike.

Queries are the frames of the way back, references those of the way out, truth as in `ebjax.paper.retrieval`. Searched
are the facing references alone, as if the direction were known, and those of both directions with the gaps in time
and path that `ebjax.slam` leaves.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from ebjax.command import progress
from ebjax.floors.corrupt import corrupt
from ebjax.paper.looks import look_at, views
from ebjax.paper.retrieval import merits
from ebjax.paper.run import Run
from ebjax.places.descriptor import Descriptor, Places
from ebjax.places.retrieve import comparable
from ebjax.places.search import rankings, search

FACING, BOTH = "facing", "both ways"
CLEAN = "clean"
GAP_S, GAP_M = 5.0, 4.0
MERITS = ("recall_at_1_0.3m", "recall_at_1_1m", "p100_1m")

Views = tuple[Float[np.ndarray, "N h w 3"], Bool[np.ndarray, "N h w"]]


def floor_views(run: Run) -> Views:
    """The floor views of the frames that are looked at, out and back, and what of them is floor.

    Raises:
      BrokenFrame: an image cannot be read.
    """
    found = [(np.asarray(view), np.asarray(seen)) for view, seen, _ in views(run, run.frames, "floor", 0)]
    colours, seen = zip(*found, strict=True)
    return np.stack(colours), np.stack(seen)


def corrupted(clean: Views, strength: float | int, *, seed: int) -> Views:
    """Every view corrupted by itself."""
    key = jax.random.key(seed)
    found = [
        corrupt(*view, strength, key=jax.random.fold_in(key, k)) for k, view in enumerate(zip(*clean, strict=True))
    ]
    colours, seen = zip(*jax.tree.map(np.asarray, found), strict=True)
    return np.stack(colours), np.stack(seen)


def measure(
    run: Run, clean: Views, methods: Mapping[str, Descriptor], strength: float | int, seeds: int
) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Figures of merit of descriptors on one run.

    Args:
      run: the run.
      clean: its `floor_views`.
      methods: descriptors by name.
      strength: of `corrupt`.
      seeds: how often the views are corrupted anew.

    Returns:
      "NAME, RANKING" -> "clean" or the seed -> FACING or BOTH -> MERITS in 0..1 and their queries.
    """
    conditions = {CLEAN: clean, **{str(seed): corrupted(clean, strength, seed=seed) for seed in range(seeds)}}
    found: dict[str, dict[str, dict[str, dict[str, Any]]]] = {}
    steps = [(name, condition) for name in methods for condition in conditions]
    for name, condition in progress(steps, len(steps), f"{run.sequence.path.name}, retrieval"):
        chosen, seed = methods[name], 0 if condition == CLEAN else int(condition)
        places = chosen.unite(look_at(chosen, _shown(conditions[condition])), seed=seed)
        for ranking in rankings(chosen.has_maps):
            found.setdefault(f"{name}, {ranking}", {})[condition] = {
                searched: _found(run, places, ranking, allowed) for searched, allowed in _allowed(run).items()
            }
    return found


def _shown(given: Views) -> Iterator[tuple[Float[Array, "h w 3"], Bool[Array, "h w"], UInt8[np.ndarray, "h w 3"]]]:
    for view, seen in zip(*given, strict=True):
        yield jnp.asarray(view), jnp.asarray(seen), np.rint(255 * view).astype(np.uint8)


def _allowed(run: Run) -> dict[str, Bool[Array, "B N 2"]]:
    """Which frames each frame of the way back is compared with, as it is and turned by pi."""
    count, frames = len(run.out), run.frames
    facing = np.zeros((len(run.back), len(frames), 2), bool)
    facing[:, :count, 1] = True
    times, travelled = (jnp.asarray(values[frames]) for values in (run.sequence.timestamps, run.distances_m))
    both = comparable(times, travelled, GAP_S, GAP_M)[count:] & (jnp.arange(len(frames)) < count)[None, :, None]
    return {FACING: jnp.asarray(facing), BOTH: both}


def _found(run: Run, places: Places, ranking: str, allowed: Bool[Array, "B N 2"]) -> dict[str, Any]:
    rows = np.arange(len(run.out), len(run.frames))
    best = search(places, allowed, ranking=ranking, queries=rows)
    j, score, opposing, valid = (
        np.asarray(part)[:, 0] for part in (best.j, 1 - best.distance, best.opposing, best.valid)
    )
    result = merits(run, np.where(valid, j, -1), score.astype(np.float64), opposing)
    kept = [key for key in result if key.startswith(MERITS) and not key.endswith(("_by_chance", "_radius_m"))]
    return {key: result[key] for key in kept}
