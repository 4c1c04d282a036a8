"""Loop candidates of a whole run from its places: a shortlist by cosine, in both directions, then the ranking.

`ranking="cosine"` is the paper's plain single-vector cosine, and all that most descriptors have. "correlation" ranks
the shortlist by the mean of that cosine and of the shift-maximised correlation of the descriptor's maps: the one knows
what is there, the other where it lies, and they err on different views. "auto" does so where there are maps.
"""

import numpy as np
from jaxtyping import Array, Bool, Int

from ebjax.places.descriptor import Places
from ebjax.places.retrieve import LoopCandidates, correlate_shortlist, merge, shortlist

SHORTLIST = 20
"""Views of each direction that are correlated with a query."""
RANKINGS = ("auto", "correlation", "cosine")


def rankings(has_maps: bool) -> tuple[str, ...]:
    """The rankings that a descriptor allows, the best first."""
    return ("correlation", "cosine") if has_maps else ("cosine",)


def check_ranking(ranking: str, has_maps: bool) -> None:
    """Raises ValueError where the ranking is unknown, or correlates what has no maps."""
    if ranking not in RANKINGS:
        raise ValueError(f"ranking {ranking!r} is unknown; choose {', '.join(RANKINGS)}")
    if ranking == "correlation" and not has_maps:
        raise ValueError("this descriptor has no maps to correlate; rank by cosine, or take rootsift-vlad")


def search(
    places: Places,
    allowed: Bool[Array, "Q N 2"],
    *,
    ranking: str = "auto",
    queries: Int[np.ndarray, "Q"] | None = None,
    top: int = SHORTLIST,
) -> LoopCandidates:
    """Up to `top` candidates of each direction for every query, ranked together, best first.

    Args:
      places: from a descriptor's `unite`.
      allowed: which views each query may be compared with, as from `retrieve.comparable`.
      ranking: one of RANKINGS.
      queries: the rows of `places` that are queries; None: all.
      top: views of each direction that are shortlisted.

    Raises:
      ValueError: as `check_ranking`.
    """
    check_ranking(ranking, places.maps is not None)
    asked = np.arange(len(places.vectors), dtype=np.int32) if queries is None else queries.astype(np.int32)
    cosine, j = shortlist(places.vectors, asked, allowed, k=top)
    if ranking == "cosine" or places.maps is None:
        score, shift = cosine, np.zeros((*j.shape, 2), np.int32)
    else:
        correlation, shift = correlate_shortlist(places.maps, asked, j, places.space)
        score = (cosine + places.share * correlation) / (1 + places.share)
    return merge(asked, j, score, shift, np.isfinite(cosine))
