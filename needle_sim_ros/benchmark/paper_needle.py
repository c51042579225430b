# SPDX-License-Identifier: Apache-2.0
"""The paper's needle, Eqs. (6) and (7) as printed, and how far it is from the exact one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needle_sim_ros.needle import beam

Array = NDArray[np.float64]


def printed_flexibility(arclengths: ArrayLike, flexural_rigidity: float) -> Array:
    """Return the flexibility matrix of Eq. (6) as printed, l_i the distance to the support.

    Row m of Eq. (6), with k_i = l_i^3 / 3EI and 3 k_j / (2 l_j) = l_j^2 / 2EI::

        omega_m = k_m sum_{i >= m} F_i
                  + sum_{j < m} (l_m - l_j) (l_j^2 / 2EI) sum_{i >= j} F_i

    Each node's own slope is taken for its whole length from the clamp and added again at
    every node before it, so the sum counts the same bending many times over: see
    :func:`tip_deflection_ratio`. The matrix is not symmetric (Maxwell-Betti).

    Parameters
    ----------
    arclengths : array_like, shape (n,)
        Distances l_i from the clamp, m, increasing, > 0.
    flexural_rigidity : float
        E I, N m^2.

    Returns
    -------
    ndarray, shape (n, n)
        Deflection of node m, m, for a unit force at node i, 1/N.
    """
    length = np.asarray(arclengths, dtype=float)
    count = len(length)
    slope = length**2 / (2 * flexural_rigidity)
    # Sums over j <= q of slope_j and of l_j slope_j, with an empty sum in front.
    slopes = np.concatenate([[0.0], np.cumsum(slope)])
    moments = np.concatenate([[0.0], np.cumsum(slope * length)])
    row, column = np.arange(count)[:, None], np.arange(count)[None, :]
    last = np.minimum(column, row - 1) + 1
    matrix: Array = length[:, None] * slopes[last] - moments[last]
    matrix += np.where(column >= row, (length**3 / (3 * flexural_rigidity))[:, None], 0.0)
    return matrix


def printed_tip_slope(arclengths: ArrayLike, flexural_rigidity: float) -> Array:
    """Return the slope of the last node per unit force at each node, in the sense of Eq. (6).

    Returns
    -------
    ndarray, shape (n,)
        rad/N.
    """
    length = np.asarray(arclengths, dtype=float)
    slope: Array = np.cumsum(length**2) / (2 * flexural_rigidity)
    return slope


def tip_deflection_ratio(nodes: int, inserted: float = 60 / 130) -> float:
    """Return how many times Eq. (6) overrates the deflection under a force at the tip.

    Parameters
    ----------
    nodes : int
        Needle nodes, evenly spaced over the inserted part, the last at the tip.
    inserted : float
        Part of the needle that is inserted; by default the paper's 60 mm of 130 mm, which
        gives 1.2 for 2 nodes and 11 for 60.
    """
    length = 1 - inserted + inserted * np.arange(1, nodes + 1) / nodes
    exact = beam.flexibility(length[-1:], length[-1:], 1.0)[0, 0]
    return float(printed_flexibility(length, 1.0)[-1, -1] / exact)
