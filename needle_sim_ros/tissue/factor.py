# SPDX-License-Identifier: Apache-2.0
"""One small interface for direct solvers of sparse symmetric positive definite systems."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.libraries import Choice, choose
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.pardiso import Pardiso
from needle_sim_ros.tissue.superlu import SuperLU


class Engine(Protocol):
    """What a library does with a matrix; made when something is first asked."""

    def solve(self, right: Vector) -> Vector:
        """Solve for one (n,) or many (n, k) right-hand sides."""
        ...

    def inverse(self) -> Vector:
        """Return the inverse's rows and columns of the last unknowns, (k, k), symmetric."""
        ...


_ENGINES: dict[str, Callable[[sp.csr_array, Index | None, Index], Engine]] = {
    "superlu": SuperLU,
    "pardiso": Pardiso,
}


class Factor:
    """A factorised matrix; the factorisation is made when the first answer is asked for.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Symmetric positive definite.
    order : ndarray of int, shape (n,), optional
        In which to eliminate the unknowns; by default one of minimum degree. Pardiso finds
        its own.
    library : Choice, optional
        SuperLU by default.
    """

    def __init__(
        self, matrix: sp.csr_array, order: Index | None = None, library: Choice | None = None
    ) -> None:
        self.size = int(matrix.shape[0])
        self.library = library or choose("superlu")
        self.solves = 0
        self.matrix, self.order = matrix, order
        self._last: Index = np.empty(0, dtype=np.intp)
        self._one_at_a_time = threading.Lock()
        self._engine: Engine | None = None

    @property
    def inverts(self) -> bool:
        """Whether a block of the inverse costs little more than the factorisation."""
        return self.order is not None or self.library.name == "pardiso"

    @property
    def factorised(self) -> bool:
        """Whether the work has been done."""
        return self._engine is not None

    def put_last(self, unknowns: Index) -> None:
        """Choose of which unknowns the inverse's block will be wanted; ascending, once each.

        They are eliminated after all others, so the rounding of solves depends on them.
        """
        if self._engine is not None:
            raise RuntimeError("the matrix is factorised already")
        self._last = unknowns

    def factorise(self) -> None:
        """Do the work now.

        Raises
        ------
        SolverError
            When the matrix is singular, or too large for the memory.
        """
        with self._one_at_a_time:
            self._made()

    def solve(self, right: Vector) -> Vector:
        """Solve for one (n,) or many (n, k) right-hand sides."""
        with self._one_at_a_time:
            self.solves += 1 if right.ndim == 1 else right.shape[1]
            return self._made().solve(right)

    def inverse(self) -> Vector:
        """Return the inverse between the unknowns that were put last, (k, k)."""
        with self._one_at_a_time:
            self.solves += len(self._last)
            return self._made().inverse()

    def _made(self) -> Engine:
        if self._engine is None:
            self._engine = _ENGINES[self.library.name](self.matrix, self.order, self._last)
        return self._engine
