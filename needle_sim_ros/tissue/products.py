# SPDX-License-Identifier: Apache-2.0
"""Matrix times vector for ticks: other threads stay out of the interpreter meanwhile.

numpy lets go of the interpreter lock for every product. A thread that waits for it then takes
it, and a tick of a tenth of a millisecond waits for as long as that thread likes.
"""

from __future__ import annotations

import numpy as np

from needle_sim_ros import compiled
from needle_sim_ros.geometry import Vector

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
