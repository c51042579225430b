# SPDX-License-Identifier: Apache-2.0
"""A Jacobian that costs one evaluation per variable once, and then nothing (Broyden)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from needle_sim_ros.geometry import Vector

# the step failed to reduce the residual to this part: the slope is measured anew
_STALLED = 0.7


class SecantJacobian:
    """The Jacobian of residuals by forward differences, kept up to date by Broyden's rule.

    Parameters
    ----------
    residuals : callable
        From (n,) to (m,).
    steps : ndarray, shape (n,)
        Of the differences.
    """

    def __init__(self, residuals: Callable[[Vector], Vector], steps: Vector) -> None:
        self._residuals, self._steps = residuals, steps
        self._at: Vector | None = None
        self._value = self._slope = np.empty(0)
        self._known: tuple[Vector, Vector] | None = None

    def function(self, x: Vector) -> Vector:
        """Return the residuals."""
        value = self._residuals(x)
        self._known = (x.copy(), value)
        return value

    def __call__(self, x: Vector) -> Vector:
        """Return the Jacobian, (m, n)."""
        value = self._value_at(x)
        if self._at is None:
            self._slope = self._measured(x, value)
        else:
            moved, change = x - self._at, value - self._value
            before, after = np.linalg.norm(self._value), np.linalg.norm(value)
            if after > _STALLED * before or not moved.any():
                self._slope = self._measured(x, value)
            else:
                wrong = change - self._slope @ moved
                self._slope = self._slope + np.outer(wrong, moved) / (moved @ moved)
        self._at, self._value = x.copy(), value
        return self._slope

    def _value_at(self, x: Vector) -> Vector:
        if self._known is not None and np.array_equal(self._known[0], x):
            return self._known[1]
        return self.function(x)

    def _measured(self, x: Vector, value: Vector) -> Vector:
        columns = []
        for axis, step in enumerate(self._steps):
            beside = x.copy()
            beside[axis] += step
            columns.append((self._residuals(beside) - value) / step)
        return np.stack(columns, axis=1)
