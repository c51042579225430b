# SPDX-License-Identifier: Apache-2.0
"""Pardiso of Intel's MKL, which pypardiso finds and loads."""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.dense import inverse
from needle_sim_ros.tissue.mesh import Index

_POSITIVE_DEFINITE = 2
# what part of the unknowns in the inverse's block is as good as all
_ALL = 0.8
_FACTORISE, _SOLVE, _RELEASE = 12, 33, -1
# MKL's numbering of processor branches: its own choice, whatever the memory's alignment
_ANY_BRANCH, _STRICT = 2, 0x10000


@cache
def _library() -> Any:
    """Load MKL; pypardiso searches the whole environment for it, which takes a second."""
    from pypardiso import PyPardisoSolver

    library: Any = PyPardisoSolver(mtype=_POSITIVE_DEFINITE).libmkl
    # one thread (below) and one code path: the same bits in every run on a machine
    library.MKL_CBWR_Set(_ANY_BRANCH | _STRICT)
    return library


class _Matrix:
    """The upper triangle as Pardiso takes it, and its memory."""

    def __init__(self, matrix: sp.csr_array) -> None:
        self.library = _library()
        self._pardiso: Any = self.library["pardiso"]  # its own: pypardiso types the arguments
        upper = sp.csr_array(sp.triu(matrix, format="csr"))
        upper.sort_indices()
        self.size = int(upper.shape[0])
        self._values = np.ascontiguousarray(upper.data, dtype=np.float64)
        self._starts = upper.indptr.astype(np.int32) + 1
        self._columns = upper.indices.astype(np.int32) + 1
        self._handle = np.zeros(64, dtype=np.int64)
        self._settings = np.zeros(64, dtype=np.int32)
        for number, value in ((1, 1), (2, 2), (10, 13), (18, -1), (21, 1)):
            self._settings[number - 1] = value

    def call(
        self,
        phase: int,
        right: Vector | None = None,
        answer: Vector | None = None,
        marked: Any = None,
    ) -> None:
        """Run a phase; `marked` (n,) is one where the Schur complement is wanted."""
        count = 1 if right is None else right.shape[1]
        self._settings[35] = 0 if marked is None else 1
        none = np.zeros(1, dtype=np.int32)
        trouble = ctypes.c_int32(0)
        before = self.library.MKL_Set_Num_Threads_Local(1)
        self._pardiso(
            *_pointers(self._handle),
            *_numbers(1, 1, _POSITIVE_DEFINITE, phase, self.size),
            *_pointers(
                self._values, self._starts, self._columns, none if marked is None else marked
            ),
            *_numbers(count),
            *_pointers(self._settings),
            *_numbers(0),
            *_pointers(right, answer),
            ctypes.byref(trouble),
        )
        self.library.MKL_Set_Num_Threads_Local(before)
        if trouble.value:
            raise SolverError(
                f"the tissue's matrix cannot be factorised: Pardiso's error {trouble.value}"
            )


def _pointers(*arrays: Any) -> list[ctypes.c_void_p]:
    return [ctypes.c_void_p(None if array is None else array.ctypes.data) for array in arrays]


def _numbers(*values: int) -> Sequence[Any]:
    return [ctypes.byref(ctypes.c_int32(value)) for value in values]


class Pardiso:
    """A Cholesky factorisation; Pardiso finds the order itself.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Symmetric positive definite.
    order : ignored
    last : ndarray of int, shape (k,)
        Unknowns between which the inverse may be asked for, ascending.
    """

    def __init__(self, matrix: sp.csr_array, order: Index | None, last: Index) -> None:
        self._source, self._last = matrix, last
        self._matrix = _Matrix(matrix)
        self._matrix.call(_FACTORISE)
        weakref.finalize(self, self._matrix.call, _RELEASE)

    def solve(self, right: Vector) -> Vector:
        """Solve for one (n,) or many (n, k) right-hand sides."""
        columns = np.asfortranarray(right.reshape(len(right), -1), dtype=np.float64)
        answer = np.empty_like(columns)
        self._matrix.call(_SOLVE, columns, answer)
        return answer.reshape(right.shape)

    def inverse(self) -> Vector:
        """Return the inverse between the last unknowns, (k, k).

        Of the Schur complement on them, for which Pardiso factorises apart: its factor
        solves no more.
        """
        if len(self._last) == 0:
            return np.zeros((0, 0))
        size = self._source.shape[0]
        if len(self._last) > _ALL * size:  # hardly anything to eliminate: Pardiso was seen to crash
            whole = inverse(np.asfortranarray(self._source.toarray()))
            return np.asarray(whole[np.ix_(self._last, self._last)])
        marked = np.zeros(size, dtype=np.int32)
        marked[self._last] = 1
        complement = np.zeros((len(self._last),) * 2)
        matrix = _Matrix(self._source)
        matrix.call(_FACTORISE, None, complement, marked)
        matrix.call(_RELEASE)
        return inverse(np.asfortranarray(complement))
