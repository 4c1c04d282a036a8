"""Sparse L D L^T by qdldl, ordered by AMD: a small wheel under a free licence, the default."""

from typing import Any

import numpy as np
import qdldl
import scipy.sparse
from jaxtyping import Float, Int


class Factor:
    """The symbolic factor of one sparsity pattern, the lower triangle by columns."""

    def __init__(self, indices: Int[np.ndarray, " Z"], indptr: Int[np.ndarray, " C"]):
        size = len(indptr) - 1
        numbered = scipy.sparse.csc_matrix((np.arange(1.0, len(indices) + 1), indices, indptr), shape=(size, size))
        upper = numbered.T.tocsc()
        upper.sort_indices()
        self._from_lower = upper.data.astype(np.int64) - 1
        self._upper = upper
        self._solver: Any = None

    def factorise(self, values: Float[np.ndarray, " Z"]) -> None:
        """Makes the numeric factor.

        Raises:
          ArithmeticError: the matrix is singular.
        """
        self._upper.data = values[self._from_lower]
        try:
            if self._solver is None:
                self._solver = qdldl.Solver(self._upper, upper=True)
            else:
                self._solver.update(self._upper, upper=True)
        except (RuntimeError, ValueError) as error:
            self._solver = None
            raise ArithmeticError(str(error)) from None

    def solve(self, right: Float[np.ndarray, " C"]) -> Float[np.ndarray, " C"]:
        """H^-1 right by the latest factor."""
        return self._solver.solve(right)
