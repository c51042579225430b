# SPDX-License-Identifier: Apache-2.0
"""The tissue on the way through a time step of Newmark's method, as far as the contact asks."""

from __future__ import annotations

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.step import FreeRows
from needle_sim_ros.tissue.response import ResponseTable
from needle_sim_ros.tissue.yielding import Yielded, Yielding


class OnTheWay:
    """Displacement without contact forces within a time step, and how forces change it.

    Parameters
    ----------
    predicted : callable
        Displacement of the rows of a table without forces at the step's end.
    begun : ContactState
        At its start.
    viscosity : float
        beta of the tissue's damping, s.
    duration : float
        Of the step, s.
    onward : ndarray, shape (k, d)
        Forces at its end if they went on evenly, N.
    settling : bool
        Whether it is a settling half.
    """

    def __init__(
        self,
        predicted: FreeRows,
        begun: ContactState,
        viscosity: float,
        duration: float,
        onward: Vector,
        settling: bool,
    ) -> None:
        self._predicted = predicted
        assert begun.track is not None
        self._start = begun.moved - begun.track.table.displacement(begun.forces)
        self._yielding = Yielding(viscosity, duration, begun.forces, onward, settling)

    def at(self, share: float) -> tuple[Yielded, FreeRows]:
        """Return how the tissue answers after a share of the step, and where it is without."""
        yielded = self._yielding.to(share)

        def free(table: ResponseTable) -> Vector:
            rows = self._predicted(table)
            known = min(len(self._start), len(rows))
            rows[:known] *= share
            rows[:known] += (1.0 - share) * self._start[:known]
            rows += table.displacement(yielded.kept[: table.count])
            return rows

        return yielded, free

    def took(self, share: float, contact: ContactState) -> None:
        """Go on from there, with the contact that was found."""
        self._yielding.took(share, contact.forces)
