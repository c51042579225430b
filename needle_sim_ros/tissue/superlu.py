# SPDX-License-Identifier: Apache-2.0
"""SuperLU, which scipy brings along."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.dense import inverse_of_factor
from needle_sim_ros.tissue.mesh import Index

_AT_ONCE = 24  # unit solves, where the trailing block cannot be used


class SuperLU:
    """A factorisation P A P' = L U without pivoting.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Symmetric positive definite.
    order : ndarray of int, shape (n,), or None
        In which to eliminate the unknowns; None leaves it to minimum degree.
    last : ndarray of int, shape (k,)
        Unknowns to eliminate last, if there is an order.
    """

    def __init__(self, matrix: sp.csr_array, order: Index | None, last: Index) -> None:
        self._last = last
        if order is not None:
            kept = np.zeros(len(order), dtype=bool)
            kept[last] = True
            order = np.concatenate([order[~kept[order]], order[kept[order]]])
            matrix = sp.csr_array(matrix[order][:, order])
        self._order = order
        try:
            self._lu = splu(
                sp.csc_matrix(matrix),
                permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except (RuntimeError, MemoryError) as error:
            raise SolverError(f"the tissue's matrix cannot be factorised: {error}") from None

    def solve(self, right: Vector) -> Vector:
        """Solve for one (n,) or many (n, k) right-hand sides."""
        if self._order is None:
            return np.asarray(self._lu.solve(right))
        answer = np.empty_like(right)
        answer[self._order] = self._lu.solve(right[self._order])
        return answer

    def inverse(self) -> Vector:
        """Return the inverse between the last unknowns, (k, k).

        The inverse's trailing block is that of the trailing part of the factor alone: what
        was eliminated before is in it already, as a Schur complement.
        """
        n, k = self._lu.shape[0], len(self._last)
        place = np.asarray(self._lu.perm_c, dtype=np.intp)
        if self._order is not None:
            of_unknown = np.empty(n, dtype=np.intp)
            of_unknown[self._order] = place
            place = of_unknown
        place = place[self._last] - (n - k)
        pivots = self._lu.U.diagonal()
        if (self._lu.perm_r != self._lu.perm_c).any() or (pivots <= 0).any():
            raise SolverError("the tissue's matrix is not positive definite")
        if k == 0 or place.min() < 0:
            return self._solved()
        lower = self._lu.L[n - k :, n - k :].toarray(order="F")
        lower *= np.sqrt(pivots[n - k :])
        return np.asarray(inverse_of_factor(lower)[np.ix_(place, place)])

    def _solved(self) -> Vector:
        """Return the same from unit solves, where the library ordered otherwise."""
        n, k = self._lu.shape[0], len(self._last)
        block = np.empty((k, k))
        for start in range(0, k, _AT_ONCE):
            part = self._last[start : start + _AT_ONCE]
            unit = np.zeros((n, len(part)), order="F")
            unit[part, np.arange(len(part))] = 1.0
            block[:, start : start + _AT_ONCE] = self.solve(unit)[self._last]
        return 0.5 * (block + block.T)
