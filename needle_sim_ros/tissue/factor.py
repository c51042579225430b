# SPDX-License-Identifier: Apache-2.0
"""One small interface for direct solvers of sparse symmetric positive definite systems."""

from __future__ import annotations

import threading

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.mesh import Index


class Factor:
    """A factorised matrix.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Symmetric positive definite.
    order : ndarray of int, shape (n,), optional
        In which to eliminate the unknowns; by default one of minimum degree.
    """

    def __init__(self, matrix: sp.csr_array, order: Index | None = None) -> None:
        self.size = int(matrix.shape[0])
        self.solves = 0
        self._one_at_a_time = threading.Lock()
        self._order = order
        if order is not None:
            matrix = sp.csr_array(matrix[order][:, order])
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
        with self._one_at_a_time:
            self.solves += 1 if right.ndim == 1 else right.shape[1]
            if self._order is None:
                return np.asarray(self._lu.solve(right))
            answer = np.empty_like(right)
            answer[self._order] = self._lu.solve(right[self._order])
            return answer
