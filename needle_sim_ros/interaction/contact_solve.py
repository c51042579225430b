# SPDX-License-Identifier: Apache-2.0
"""The contact problem of a tick: min 1/2 x'Ax - b'x with low <= x <= high.

A is the compliance of tissue, needle and presliding, symmetric positive definite, so the
solution exists, is unique and depends on no history. From a tick to the next few variables
change sides, and block principal pivoting (Portugal, Judice and Vicente 1994) finds these in
one to three linear systems: all that are wrongly free or bound are exchanged, while they get
fewer, give or take two times. Where they do not, projected Newton (Bertsekas 1982) goes on:
variables at a bound that the gradient presses outwards stay there, the others take a Newton
step, and the projected step is shortened until the objective falls by Armijo's rule. Every
iteration lowers a strictly convex function and there are finitely many sets of bound variables,
so it ends. Should rounding stall it all the same, pivots one at a time end by construction for
any such matrix.
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
# part of a bound by which rounding may take a free variable beyond it
_BESIDE = 1e-12
# block pivots without progress before projected Newton, and before single pivots
_FEW_CHANCES, _CHANCES = 2, 10


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
    problem = _Problem(matrix, right, low, high)
    found = _exchanged(problem, status, allowed)
    if isinstance(found, ContactSolution):
        return found
    return _descended(problem, status, allowed, found)


@dataclass(frozen=True)
class _Problem:
    matrix: Vector
    right: Vector
    low: Vector
    high: Vector

    def held(self, state: NDArray[np.int8], beside: float = 0.0) -> tuple[Vector, Vector]:
        """Return x with the variables at their bounds and the rest at their minimum; gradient.

        What is beyond a bound by less than a part of it is put there.
        """
        x = np.where(state < 0, self.low, np.where(state > 0, self.high, 0.0))
        free = state == 0
        x[free] = _newton(self.matrix, self.right, x, free)
        if beside:
            nearest = np.clip(x, self.low, self.high)
            x = np.where(np.abs(x - nearest) <= beside * np.abs(nearest), nearest, x)
        return x, self.matrix @ x - self.right

    def wrong(
        self, state: NDArray[np.int8], x: Vector, gradient: Vector, slack: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
        """Return which variables are wrongly free or bound, and where these belong."""
        free = state == 0
        below, above = free & (x < self.low), free & (x > self.high)
        inward = (state * gradient > slack) & (self.low < self.high)
        return below | above | inward, np.where(below, -1, above).astype(np.int8)


def _exchanged(
    problem: _Problem, status: NDArray[np.int8], allowed: float
) -> ContactSolution | int:
    """Exchange what is wrong while it gets less; else return how many systems that took."""
    state = np.where(problem.low == problem.high, -1, status).astype(np.int8)
    fewest, chances, iteration = len(state) + 1, _FEW_CHANCES, 0
    while True:
        iteration += 1
        x, gradient = problem.held(state, _BESIDE)
        wrong, where = problem.wrong(state, x, gradient, allowed)
        count = int(np.count_nonzero(wrong))
        if count == 0 and np.abs(gradient[state == 0]).max(initial=0.0) <= allowed:
            # what nothing presses against its bound counts as free
            state[(np.abs(gradient) <= allowed) & (problem.low < problem.high)] = 0
            return ContactSolution(x, gradient, state, iteration)
        chances -= count >= fewest
        if count == 0 or chances < 0:
            return iteration
        fewest = min(count, fewest)
        state[wrong] = where[wrong]


def _descended(
    problem: _Problem, status: NDArray[np.int8], allowed: float, spent: int
) -> ContactSolution:
    """Go down by projected Newton, which ends wherever it begins."""
    matrix, right, low, high = problem.matrix, problem.right, problem.low, problem.high
    x, _ = problem.held(status)
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
            return ContactSolution(x, gradient, state, spent + iteration)
        target = x.copy()
        target[free] = _newton(matrix, right, x, free)
        x, gradient = _armijo(matrix, right, x, gradient, target, low, high, free)
    return _pivoted(problem, allowed, spent + _MOST_ITERATIONS)


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


def _pivoted(problem: _Problem, allowed: float, spent: int) -> ContactSolution:
    """Exchange all variables that are wrongly free or bound, or one when that does not help."""
    matrix, right = problem.matrix, problem.right
    state = np.where(problem.low == problem.high, -1, 0).astype(np.int8)
    fewest, chances = len(right) + 1, _CHANCES
    for iteration in range(1, 100 + 20 * len(right)):
        x, gradient = problem.held(state)
        wrong, where = problem.wrong(state, x, gradient, max(allowed, _rounding(matrix, x)))
        count = int(np.count_nonzero(wrong))
        if count == 0:
            return ContactSolution(x, gradient, state, spent + iteration)
        if count < fewest:
            fewest, chances = count, _CHANCES
        elif chances > 0:
            chances -= 1
        else:  # Murty's rule
            wrong[: np.flatnonzero(wrong)[-1]] = False
        state[wrong] = where[wrong]
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
