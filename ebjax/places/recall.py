"""Recall of loop candidates against ground truth, as DESIGN and the paper count it. NumPy only.

A later view counts as a query if an earlier one faces it (headings within 25 degrees of opposite) and looks at the same
floor: the centres of the two floor views lie within the radius. R@1 is the share of queries whose first candidate is
such a view. On runs that pass a place more than twice the first candidate may as well be an earlier view in the same
direction; `judged_claims` counts it as right where it is claimed to be one.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

FACING_RAD = np.radians(25.0)
ROWS = 256
"""Later views that are compared with all earlier ones at a time."""


def facing_pairs(
    world_from_base: Float[np.ndarray, "N 3"],
    centre_m: Float[np.ndarray, "2"],
    radius_m: float,
    rows: slice = slice(None),
) -> Bool[np.ndarray, "n N"]:
    """Which earlier views j (columns) show a later view i (rows) the same floor from the opposite side.

    Args:
      world_from_base: true x, y (m) and heading (rad); NaN rows pair with nothing.
      centre_m: of the floor view, in base.
      radius_m: largest distance of the two centres.
      rows: which later views; all of them are N^2 numbers.
    """
    heading, order = world_from_base[:, 2], np.arange(len(world_from_base))
    centres = _centres(world_from_base, centre_m)
    near = np.linalg.norm(centres[rows, None] - centres[None, :], axis=-1) <= radius_m
    turned = _within(heading[rows, None] - heading[None, :] - np.pi)
    return near & turned & (order[rows, None] > order[None, :])


def judged_claims(
    world_from_base: Float[np.ndarray, "N 3"],
    centre_m: Float[np.ndarray, "2"],
    radius_m: float,
    first: Int[np.ndarray, "N"],
    opposing: Bool[np.ndarray, "N"],
) -> tuple[Bool[np.ndarray, "N"], Bool[np.ndarray, "N"]]:
    """Whether the first candidate of every view shows the same floor from the side it claims; and which are queries.

    Args:
      world_from_base: as `facing_pairs`.
      centre_m: see there.
      radius_m: see there.
      first: the first candidate of every view, -1 where there is none.
      opposing: whether it is claimed as seen from the opposite side.
    """
    blocks = (slice(start, start + ROWS) for start in range(0, len(first), ROWS))
    asked = [facing_pairs(world_from_base, centre_m, radius_m, rows).any(1) for rows in blocks]
    centres = _centres(world_from_base, centre_m)
    near = np.linalg.norm(centres - centres[first], axis=-1) <= radius_m
    turn = world_from_base[:, 2] - world_from_base[first, 2] - np.where(opposing, np.pi, 0.0)
    return near & _within(turn) & (first >= 0), np.concatenate([np.zeros(0, bool), *asked])


def _centres(world_from_base: Float[np.ndarray, "N 3"], centre_m: Float[np.ndarray, "2"]) -> Float[np.ndarray, "N 2"]:
    c, s = np.cos(world_from_base[:, 2]), np.sin(world_from_base[:, 2])
    rotation = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], 1)
    return world_from_base[:, :2] + rotation @ centre_m


def _within(turn: Float[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
    return np.abs(np.arctan2(np.sin(turn), np.cos(turn))) <= FACING_RAD


def recall_at_1(
    first: Int[np.ndarray, "N"], opposing: Bool[np.ndarray, "N"], pairs: Bool[np.ndarray, "N N"]
) -> tuple[float | None, int]:
    """The share of queries whose first candidate is a true facing view, and the number of queries (None without any).

    Args:
      first: the first candidate of every view, -1 where there is none.
      opposing: whether it is claimed as seen from the opposite side.
      pairs: from `facing_pairs`.
    """
    queries = pairs.any(1)
    if not queries.any():
        return None, 0
    right = pairs[np.arange(len(first)), np.maximum(first, 0)] & (first >= 0) & opposing
    return float(right[queries].mean()), int(queries.sum())


def precision_100(score: Float[np.ndarray, "N"], right: Bool[np.ndarray, "N"]) -> float:
    """P100: the share of all views that can be accepted, best score first, before the first wrong one.

    Args:
      score: of the first candidate of every later view; -inf where there is none.
      right: whether that candidate is true.
    """
    if not len(score):
        return 0.0
    order = np.argsort(-score, kind="stable")
    wrong = ~right[order]
    return float((np.argmax(wrong) if wrong.any() else len(score)) / len(score))


def recall_at(
    ranked: Sequence[Sequence[int]], accepted: Mapping[int, Sequence[int]], k: int
) -> tuple[float | None, int]:
    """R@k of image retrieval: the share of queries with an accepted reference among their first k, and their number.

    Args:
      ranked: of every query, its references, best first.
      accepted: query -> references that show its place; queries without any do not count.
      k: candidates that are looked at.
    """
    found = [bool(set(ranked[query][:k]) & set(references)) for query, references in accepted.items() if references]
    return (sum(found) / len(found) if found else None), len(found)
