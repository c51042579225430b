# SPDX-License-Identifier: Apache-2.0
"""What a simulation cost so far."""

from __future__ import annotations

import numpy as np

from needle_sim_ros.geometry import Vector

_KEPT = 20_000


class Statistics:
    """Tick times and solver work, the last ticks in a ring.

    Attributes
    ----------
    ticks : int
        Ticks counted.
    iterations : int
        Contact systems solved.
    solves : int
        Right-hand sides solved with the tissue's factorised matrix, the set-up included.
    waits : int
        Times that a tick waited for such a solve.
    worst_residual : float
        Largest relative violation of equilibrium seen.
    last_tick_time : float
        Duration of the last tick, s.
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.iterations = 0
        self.solves = 0
        self.waits = 0
        self.worst_residual = 0.0
        self.last_tick_time = 0.0
        self._ring = np.zeros(_KEPT)

    def tick(self, duration: float, iterations: int, residual: float) -> None:
        """Count a tick of some duration, s."""
        self._ring[self.ticks % _KEPT] = self.last_tick_time = duration
        self.ticks += 1
        self.iterations += iterations
        if residual > self.worst_residual:
            self.worst_residual = residual

    @property
    def tick_times(self) -> Vector:
        """Durations of the last ticks, s, the oldest first."""
        if self.ticks <= _KEPT:
            return self._ring[: self.ticks].copy()
        return np.roll(self._ring, -(self.ticks % _KEPT))
