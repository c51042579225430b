# SPDX-License-Identifier: Apache-2.0
"""In what numbers a fit searches, so that it meets no scene that there cannot be.

Static friction is never below kinetic, nor puncture below cutting. Where both of a pair are
fitted, the search has the lower one and by how much the other is above it, which is bounded
by zero: a bound on one number, while that of the pair would be on both at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.parameters import ORDERED, Parameter


class Coordinates:
    """Sizes of parameters, and the numbers w in which they are searched for.

    Parameters
    ----------
    parameters : sequence of Parameter
    start : ndarray, shape (p,)
        Values; of positive parameters they are the sizes.

    Raises
    ------
    NeedleSimError
        When a positive parameter starts at zero, or the lower of a pair above the other.

    Attributes
    ----------
    size : ndarray, shape (p,)
        What counts as a large change of each parameter; u is values over sizes.
    low, high : ndarray, shape (p,)
        Bounds of w.
    into : ndarray, shape (p, p)
        u = into @ w.
    """

    def __init__(self, parameters: Sequence[Parameter], start: Vector) -> None:
        for parameter, value in zip(parameters, start, strict=True):
            if parameter.positive and value <= 0:
                raise NeedleSimError(
                    f"{parameter.name} = {value:g} at the start: must be above zero; set it with"
                    f" --set {parameter.key}=..."
                )
        sizes = [p.size or v for p, v in zip(parameters, start, strict=True)]
        self.size = np.array(sizes, dtype=float)
        units = np.array([p.size or 1.0 for p in parameters])
        self.low = np.array([p.low for p in parameters]) / units
        self.high = np.array([p.high for p in parameters]) / units
        self.into = np.eye(len(parameters))
        place = {parameter.name: k for k, parameter in enumerate(parameters)}
        for lower, upper in ORDERED:
            if lower in place and upper in place:
                i, j = place[lower], place[upper]
                if start[j] < start[i]:
                    raise NeedleSimError(
                        f"{upper} = {start[j]:g} at the start: must be >= {lower}, {start[i]:g}"
                    )
                self.into[j, i] = self.size[i] / self.size[j]
                self.low[j] = 0.0
        self._back = np.linalg.inv(self.into)

    def searched(self, u: Vector) -> Vector:
        """Return w of values in sizes, shapes (p,)."""
        return np.asarray(self._back @ u)

    def sized(self, w: Vector) -> Vector:
        """Return values in sizes of w, shapes (p,)."""
        return np.asarray(self.into @ w)

    def by_sizes(self, derivatives: Vector) -> Vector:
        """Return derivatives by u, (n, p), of those by w."""
        return np.asarray(derivatives @ self._back)

    def clipped(self, u: Vector) -> Vector:
        """Return the values in sizes, (p,), put within the bounds."""
        return self.sized(np.clip(self.searched(u), self.low, self.high))
