# SPDX-License-Identifier: Apache-2.0
"""The needle as an Euler-Bernoulli cantilever, massless, clamped at the base.

Replaces Eq. (6) of the paper, whose printed form is not symmetric and overestimates the
deflection under a tip load; the flexibility form needs no inverse (Eq. 7).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def flexibility(at: Vector, load: Vector, rigidity: float) -> Vector:
    """Return the deflection at `at` per unit lateral force at `load`.

    C_n(s_i, s_j) = a^2 (3 b - a) / (6 E I), a = min, b = max of the arclengths.

    Parameters
    ----------
    at : ndarray, shape (n,)
        Arclengths from the clamp, m, >= 0.
    load : ndarray, shape (k,)
        Arclengths of the forces, m, >= 0.
    rigidity : float
        Flexural rigidity E I, N m^2.

    Returns
    -------
    ndarray, shape (n, k)
        Flexibility, m/N; symmetric when `at` is `load` (Maxwell-Betti).
    """
    a = np.minimum(at[:, None], load[None, :])
    b = np.maximum(at[:, None], load[None, :])
    b *= 3.0
    b -= a
    a *= a
    b *= a
    b /= 6.0 * rigidity
    return np.asarray(b)


def tip_slope_flexibility(load: Vector, rigidity: float) -> Vector:
    """Return the slope of the tip per unit lateral force at `load`, shape (k,), 1/N.

    s^2 / (2 E I), as everywhere beyond the force: the derivative of :func:`flexibility`.

    Parameters
    ----------
    load : ndarray, shape (k,)
        Arclengths of the forces, m, between clamp and tip.
    rigidity : float
        Flexural rigidity E I, N m^2.
    """
    return np.asarray(load * load * (0.5 / rigidity))
