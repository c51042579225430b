# SPDX-License-Identifier: Apache-2.0
"""How the tissue answers a step: the interface, and the quasi-static answer.

A step first predicts what the tissue would do without contact forces; the contact
problem then finds the forces; the step is completed with them. Whatever a dynamics
remembers is a state that is replaced, never changed in place.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.products import product
from needle_sim_ros.tissue.response import ModalPart, Reading, ResponseTable
from needle_sim_ros.tissue.yielding import Yielded

# m, N and their rates: far below what counts, far above where numbers lose digits
_NEGLIGIBLE = 1e-200


class Prediction(Protocol):
    """The end of a step as it would be without contact forces in it."""

    def rows(self, table: ResponseTable) -> Vector:
        """Return the displacement of the rows of a table, shape (n, d), m."""
        ...


class WithinStep(NamedTuple):
    """Where in a step the tissue is.

    Attributes
    ----------
    state : Any
        At the start.
    prediction : Any
        Of the end, without contact forces.
    yielded : Yielded or None
        How it answers there; None at the step's end.
    """

    state: Any
    prediction: Any
    yielded: Yielded | None = None

    @property
    def share(self) -> float:
        """Of the step that has passed."""
        return 1.0 if self.yielded is None else self.yielded.share

    def acting(self, forces: Vector) -> Vector:
        """Return what forces (n, d) come to on the tissue between start and prediction, N."""
        return forces if self.yielded is None else self.yielded.acting(forces)


class Dynamics(Protocol):
    """What the contact and the observation need of the tissue."""

    compliance: NodalCompliance

    @property
    def modes(self) -> ModalPart | None:
        """Modes that amend the compliance of a step."""
        ...

    @property
    def settles(self) -> bool:
        """Whether a step can be taken as two settling halves, after a jump of the motion."""
        ...

    def initial(self) -> Any:
        """Return the state at rest."""
        ...

    def predict(self, state: Any, settling: bool = False) -> Prediction:
        """Start a step, or half a step that settles."""
        ...

    def complete(self, state: Any, prediction: Any, table: ResponseTable, forces: Vector) -> Any:
        """End a step with forces (n, d) on the rows of a table; return the new state."""
        ...

    def at(
        self, step: WithinStep, table: ResponseTable, forces: Vector, reading: Reading
    ) -> Vector:
        """Return the displacement of a footprint within a step, shape (d,).

        Under `forces` on the rows, (n, d), N.
        """
        ...

    def at_readers(self, state: Any, table: ResponseTable, forces: Vector) -> Vector:
        """Return the displacement of the readers, shape (r,)."""
        ...

    def everywhere(self, state: Any, table: ResponseTable, forces: Vector) -> Vector:
        """Return the displacement of all nodes, shape (nodes, d); costs a solve."""
        ...


def expand(model: TissueModel, values: Vector) -> Vector:
    """Put values of the free unknowns on all nodes, shape (nodes, d)."""
    full = np.zeros(model.nodes * model.dimension)
    full[model.free] = values
    return full.reshape(-1, model.dimension)


def flushed(values: Vector) -> Vector:
    """Make zero, in place, what has decayed to nothing; return the same array.

    Motion that dies away would end in subnormal numbers, below 1e-308, with which processors
    count several times slower.
    """
    values += _NEGLIGIBLE
    values -= _NEGLIGIBLE
    return values


class _AtRest:
    def rows(self, table: ResponseTable) -> Vector:
        return np.zeros((table.count, table.compliance.dimension))


class QuasiStatic:
    """No inertia, no damping: the tissue is in equilibrium with the forces of the moment."""

    modes = None
    settles = False

    def __init__(self, model: TissueModel, factor: Factor, compliance: NodalCompliance) -> None:
        self._model, self._factor, self.compliance = model, factor, compliance

    def initial(self) -> None:
        """Nothing is remembered."""
        return

    def predict(self, state: None, settling: bool = False) -> _AtRest:
        """Without forces the tissue is at rest."""
        return _AtRest()

    def complete(
        self, state: None, prediction: _AtRest, table: ResponseTable, forces: Vector
    ) -> None:
        """Nothing is remembered."""
        return

    def at(
        self, step: WithinStep, table: ResponseTable, forces: Vector, reading: Reading
    ) -> Vector:
        """Displacement of a footprint from the kept responses."""
        return reading.displacement(forces)

    def at_readers(self, state: None, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of the readers from the kept responses."""
        return product(table.at_readers(), forces.ravel())

    def everywhere(self, state: None, table: ResponseTable, forces: Vector) -> Vector:
        """One solve of Eq. (5)."""
        loads = table.spread(forces).ravel()[self._model.free]
        return expand(self._model, self._factor.solve(loads))
