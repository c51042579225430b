# SPDX-License-Identifier: Apache-2.0
"""The contact problem of a tick: min 1/2 x'Ax - b'x with low <= x <= high.

A is the compliance of tissue, needle and presliding, symmetric positive definite, so the
solution exists, is unique and depends on no history. Projected Newton (Bertsekas 1982):
variables at a bound that the gradient presses outwards stay there, the others take a
Newton step, and the projected step is shortened until the objective falls by Armijo's
rule. Every iteration lowers a strictly convex function and there are finitely many sets
of bound variables, so it ends; a warm start usually makes it end after one step. Should
rounding stall it all the same, block principal pivoting (Portugal, Judice and Vicente
1994) takes over: its single pivots end by construction for any such matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector

_MOST_ITERATIONS = 50
# iterations after which rounding, not the method, may be what keeps the gradient up
_PATIENCE = 10
# runs of rows from which a block is gathered entry by entry
_FEW_RUNS = 4
# block pivots without progress before single ones
_CHANCES = 10


@dataclass(frozen=True)
class ContactSolution:
    """Solution of the bounded problem.

    Attributes
    ----------
    x : ndarray, shape (n,)
    gradient : ndarray, shape (n,)
        A x - b: the multipliers of the bounds, 0 for free variables.
    status : ndarray of int8, shape (n,)
        -1 at the lower bound, 1 at the upper, 0 between.
    iterations : int
        Linear systems solved.
    """

    x: Vector
    gradient: Vector
    status: NDArray[np.int8]
    iterations: int


def solve_contact(
    matrix: Vector,
    right: Vector,
    low: Vector,
    high: Vector,
    status: NDArray[np.int8],
    tolerance: float = 1e-10,
) -> ContactSolution:
    """Solve the bounded problem.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Symmetric positive definite.
    right, low, high : ndarray, shape (n,)
        Bounds may be infinite and may coincide.
    status : ndarray of int8, shape (n,)
        Guess of which variables are at a bound; any guess leads to the same solution.
    tolerance : float
        Allowed multiplier of the wrong sign, relative to the largest entry of `right`.

    Raises
    ------
    SolverError
        When the matrix is not positive definite, or no solution is found.
    """
    scale = max(float(np.abs(right).max(initial=0.0)), 1e-300)
    allowed = tolerance * scale
    x = np.where(status < 0, low, np.where(status > 0, high, 0.0))
    free = status == 0
    x[free] = _newton(matrix, right, x, free)
    np.clip(x, low, high, out=x)
    gradient = matrix @ x - right
    for iteration in range(1, _MOST_ITERATIONS):
        at_low, at_high = x <= low, x >= high
        pressed = (at_low & (gradient > 0)) | (at_high & (gradient < 0))
        free = ~pressed
        if iteration > _PATIENCE:
            allowed = max(allowed, _rounding(matrix, x))
        if not free.any() or float(np.abs(gradient[free]).max()) <= allowed:
            state = np.zeros(len(x), dtype=np.int8)
            state[at_low & pressed] = -1
            state[at_high & ~at_low & pressed] = 1
            # free variables that happen to stand on a bound count as free
            return ContactSolution(x, gradient, state, iteration)
        target = x.copy()
        target[free] = _newton(matrix, right, x, free)
        x, gradient = _armijo(matrix, right, x, gradient, target, low, high, free)
    return _pivoted(matrix, right, low, high, allowed)


def _newton(matrix: Vector, right: Vector, x: Vector, free: NDArray[np.bool_]) -> Vector:
    """Minimise over the free variables, the others held."""
    count = int(np.count_nonzero(free))
    if count == 0:
        return np.empty(0)
    if count == len(x):
        block, load = matrix, right
    else:
        rows = np.flatnonzero(free)
        load = right[rows] - (matrix @ np.where(free, 0.0, x))[rows]
        block = _block(matrix, rows)
    # the transpose of a symmetric block is Fortran-ordered without a second copy
    factor, info = lapack.dpotrf(block.T, lower=1, clean=0)
    if info != 0:
        raise SolverError("the contact compliance is not positive definite")
    solution, _ = lapack.dpotrs(factor, load, lower=1)
    return np.asarray(solution)


def _block(matrix: Vector, rows: NDArray[np.intp]) -> Vector:
    """Return the rows and columns of a matrix; what sticks does so in a few runs of points."""
    count = len(rows)
    if rows[-1] == count - 1:
        return matrix[:count, :count]
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    if len(breaks) >= _FEW_RUNS:
        return np.asarray(matrix[np.ix_(rows, rows)])
    edges = [0, *breaks.tolist(), count]
    runs = [(a, b, int(rows[a])) for a, b in pairwise(edges)]
    block = np.empty((count, count))
    for a, b, first in runs:
        for c, d, other in runs:
            block[a:b, c:d] = matrix[first : first + b - a, other : other + d - c]
    return block


def _rounding(matrix: Vector, x: Vector) -> float:
    """Bound what rounding leaves of a gradient; no entry is above the largest of the diagonal."""
    largest = float(matrix.diagonal().max()) * float(np.abs(x).sum())
    return 4 * float(np.finfo(float).eps) * largest


def _pivoted(
    matrix: Vector, right: Vector, low: Vector, high: Vector, allowed: float
) -> ContactSolution:
    """Exchange all variables that are wrongly free or bound, or one when that does not help."""
    closed = low == high
    state = np.where(closed, -1, 0).astype(np.int8)
    fewest, chances = len(right) + 1, _CHANCES
    for iteration in range(1, 100 + 20 * len(right)):
        x = np.where(state < 0, low, np.where(state > 0, high, 0.0))
        free = state == 0
        x[free] = _newton(matrix, right, x, free)
        gradient = matrix @ x - right
        slack = max(allowed, _rounding(matrix, x))
        below, above = free & (x < low), free & (x > high)
        inward = ((state < 0) & (gradient < -slack)) | ((state > 0) & (gradient > slack))
        wrong = below | above | (inward & ~closed)
        count = int(np.count_nonzero(wrong))
        if count == 0:
            return ContactSolution(x, gradient, state, _MOST_ITERATIONS + iteration)
        if count < fewest:
            fewest, chances = count, _CHANCES
        elif chances > 0:
            chances -= 1
        else:  # Murty's rule
            wrong[: np.flatnonzero(wrong)[-1]] = False
        state[wrong] = np.where(below, -1, np.where(above, 1, 0))[wrong]
    raise SolverError("the contact problem has no solution within its rounding")


def _armijo(
    matrix: Vector,
    right: Vector,
    x: Vector,
    gradient: Vector,
    target: Vector,
    low: Vector,
    high: Vector,
    free: NDArray[np.bool_],
) -> tuple[Vector, Vector]:
    step = 1.0
    direction = target - x
    slope = float(gradient[free] @ direction[free])
    while True:
        trial = np.clip(x + step * direction, low, high)
        moved = trial - x
        change = matrix @ moved
        fall = float(gradient @ moved + 0.5 * (moved @ change))
        if fall <= 1e-4 * step * slope or step < 1e-10:
            return trial, gradient + change
        step *= 0.5
