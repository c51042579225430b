# SPDX-License-Identifier: Apache-2.0
"""Inverses of dense symmetric positive definite matrices, in place as far as that goes."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector


def inverse(matrix: Vector) -> Vector:
    """Return the inverse of a matrix (k, k), of which the lower triangle is read."""
    factor, trouble = lapack.dpotrf(matrix, lower=1, overwrite_a=1)
    if trouble:
        raise SolverError("the tissue's matrix is not positive definite")
    return inverse_of_factor(factor)


def inverse_of_factor(lower: Vector) -> Vector:
    """Return the inverse of L L', (k, k), to the bit symmetric; L may be overwritten."""
    answer, trouble = lapack.dpotri(lower, lower=1, overwrite_c=1)
    if trouble:
        raise SolverError("the tissue's matrix is not positive definite")
    answer = np.tril(answer)
    return np.asarray(answer + np.tril(answer, -1).T)
