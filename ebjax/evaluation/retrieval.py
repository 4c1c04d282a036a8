"""Curves of place recognition. NumPy only."""

import numpy as np
from jaxtyping import Bool, Float


def precision_recall(
    score: Float[np.ndarray, " N"], right: Bool[np.ndarray, " N"], answerable: int
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Precision and recall as answers are accepted one by one, best score first.

    Args:
      score: of every query's answer; larger is surer.
      right: whether it is true.
      answerable: queries that have a true answer.

    Returns:
      right among those accepted / accepted, and right among those accepted / answerable.
    """
    order = np.argsort(-score, kind="stable")
    true = np.cumsum(right[order])
    return true / np.arange(1, len(score) + 1), true / max(answerable, 1)
