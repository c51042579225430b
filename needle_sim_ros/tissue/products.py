# SPDX-License-Identifier: Apache-2.0
"""Sums of products for ticks: other threads stay out of the interpreter meanwhile.

numpy lets go of the interpreter lock for every product, and for what it gathers. A thread that
waits for it then takes it, and a tick of a tenth of a millisecond waits for as long as that
thread likes.
"""

from __future__ import annotations

import numpy as np

from needle_sim_ros import compiled
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.mesh import Index

try:
    from needle_sim_ros.tissue import _products
except ImportError:  # built without a compiler, or run from the source
    _products = None  # type: ignore[assignment]

_COMPILED = _products is not None and compiled.wanted()


def product(matrix: Vector, vector: Vector) -> Vector:
    """Return a matrix (m, n) times a vector (n,), both of doubles, shape (m,)."""
    if not _COMPILED:
        return np.asarray(matrix @ vector)
    out = np.empty(len(matrix))
    _products.product_into(matrix, vector, out)
    return out


def weighted_rows(matrix: Vector, rows: Index, weights: Vector, low: int, high: int) -> Vector:
    """Return the weighted sum of rows (k,) of a matrix in columns `low` to `high`.

    Added up row by row: unlike a product it gives the same bits whatever columns are asked for.
    """
    if not _COMPILED:
        return np.asarray(np.einsum("k,kn->n", weights, matrix[rows, low:high]))
    out = np.empty(high - low)
    _products.rows_into(matrix, rows, weights, low, out)
    return out


def samples(field: Vector, places: Index, weights: Vector, starts: Index, wide: int) -> Vector:
    """Return weighted sums of a field of vectors over groups of places, shape (n wide,).

    Parameters
    ----------
    field : ndarray, shape (places wide,)
        Vector after vector.
    places : ndarray of int, shape (l,)
        Where it is read, group after group.
    weights : ndarray, shape (l,)
    starts : ndarray of int, shape (n,)
        Where each group begins, none of them empty.
    wide : int
        Components of a vector.
    """
    if not _COMPILED:
        read = field.reshape(-1, wide)[places] * weights[:, None]
        return np.asarray(np.add.reduceat(read, starts, axis=0).ravel())
    out = np.empty(wide * len(starts))
    _products.samples_into(field, places, weights, starts, out)
    return out
