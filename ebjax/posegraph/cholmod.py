"""Supernodal sparse Cholesky by CHOLMOD, from the wheel of cvxopt: several times faster where fill is heavy, as in 3D.

Optional because of its licence: cvxopt is under the GPL 3.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Int


class Factor:
    """The symbolic factor of one sparsity pattern, the lower triangle by columns.

    Raises:
      ModuleNotFoundError: cvxopt is not installed.
    """

    def __init__(self, indices: Int[np.ndarray, " Z"], indptr: Int[np.ndarray, " C"]):
        import cvxopt
        from cvxopt import cholmod

        self._cvxopt, self._cholmod = cvxopt, cholmod
        size = len(indptr) - 1
        columns = np.repeat(np.arange(size), np.diff(indptr))
        self._matrix = cvxopt.spmatrix(1.0, indices.astype(int), columns, (size, size))
        cholmod.options["supernodal"] = 2
        self._factor: Any = cholmod.symbolic(self._matrix)

    def factorise(self, values: Float[np.ndarray, " Z"]) -> None:
        """Makes the numeric factor.

        Raises:
          ArithmeticError: the matrix is not positive definite.
        """
        self._matrix.V = self._cvxopt.matrix(values)
        self._cholmod.numeric(self._matrix, self._factor)

    def solve(self, right: Float[np.ndarray, " C"]) -> Float[np.ndarray, " C"]:
        """H^-1 right by the latest factor."""
        x = self._cvxopt.matrix(right)
        self._cholmod.solve(self._factor, x)
        return np.asarray(x).ravel()
