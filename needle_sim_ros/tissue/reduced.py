# SPDX-License-Identifier: Apache-2.0
"""Newmark's method on the lowest modes, and the massless answer of all others.

The static response holds every mode. The lowest ones are taken out of it and moved with
inertia; the rest, far above the frequencies that a step resolves, keep only stiffness and
the damping beta K. As beta is one number, all of them relax alike, and a filtered force
stands for them (the mode-acceleration method with damped residual modes). A step costs
modes times track points, whatever the mesh.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.dynamics import WithinStep, expand
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.modal_step import Coefficients, loaded, moved, unloaded
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.newmark import NewmarkRule
from needle_sim_ros.tissue.response import ModalPart, Reading, ResponseTable


class ModalMotion(NamedTuple):
    """Modal displacement, velocity, acceleration (3, m); filtered and last forces, (n, d)."""

    modal: Vector
    filtered: Vector
    forces: Vector


class ModalPrediction(NamedTuple):
    """Modal displacement and filtered forces at the end of a step without contact forces."""

    u: Vector
    filtered: Vector
    rule: Coefficients

    def rows(self, table: ResponseTable) -> Vector:
        """Return the displacement of the rows of a table, shape (n, d)."""
        rows = moved(table.residual(), table.modal(), self.filtered, self.u)
        return rows.reshape(table.count, -1)


def lowest_modes(model: TissueModel, factor: Factor, count: int) -> tuple[Vector, Vector]:
    """Return eigenvalues (rad^2/s^2), shape (m,), and mass-normal shapes, (free, m)."""
    size = len(model.free)
    inverse = LinearOperator((size, size), matvec=factor.solve, dtype=float)
    start = np.ones(size)  # a fixed start makes the modes the same each time
    values, shapes = eigsh(
        model.stiffness, k=min(count, size - 2), M=model.mass, sigma=0.0, OPinv=inverse, v0=start
    )
    order = np.argsort(values)
    return values[order], shapes[:, order]


def _widened(forces: Vector, count: int) -> Vector:
    if len(forces) >= count:
        return forces[:count]
    wider = np.zeros((count, forces.shape[1]))
    wider[: len(forces)] = forces
    return wider


class ReducedNewmark:
    """Second-order dynamics of the lowest modes, massless damped dynamics of the others."""

    def __init__(
        self,
        model: TissueModel,
        factor: Factor,
        compliance: NodalCompliance,
        rule: NewmarkRule,
        modes: tuple[Vector, Vector],
    ) -> None:
        self._model, self._factor, self.compliance = model, factor, compliance
        self.rule = rule
        self.eigenvalues, shapes = modes  # of lowest_modes
        self._damping = rule.alpha + rule.beta * self.eigenvalues
        stiff = rule.delta / (rule.xi * rule.step)
        self._dynamic = 1.0 / (
            self.eigenvalues + 1.0 / (rule.xi * rule.step**2) + stiff * self._damping
        )
        self._flexibility = 1.0 / self.eigenvalues
        # beta u' + u = C f by the same rule as the modes, so that full order is what it tends to
        ratio = np.inf if rule.beta == 0 else rule.step / rule.beta
        weight = 1.0 + rule.delta * ratio
        self._share = 1.0 if rule.beta == 0 else rule.delta * ratio / weight
        undamped = rule.beta == 0
        self._newmark = self._coefficients(
            rule,
            0.0 if undamped else (1 - (1 - rule.delta) * ratio) / weight,
            0.0 if undamped else (1 - rule.delta) * ratio / weight,
        )
        self._settling = self._coefficients(rule.settling(), 1.0 - self._share, 0.0)
        nodal = np.stack([expand(model, shape) for shape in shapes.T], axis=2)
        read_shapes = np.asarray(compliance.reader_matrix @ shapes)
        self.modes = ModalPart(nodal, read_shapes, self._dynamic, self._flexibility, self._share)
        self._at_readers = np.ascontiguousarray(read_shapes.T)
        self._shapes = shapes

    def _coefficients(self, rule: NewmarkRule, filtered: float, forces: float) -> Coefficients:
        """Read off unit states what a rule carries on."""
        one, zero = np.ones(1), np.zeros(1)
        units = [(one, zero, zero), (zero, one, zero), (zero, zero, one)]
        history = [rule.history(*unit) for unit in units]
        carry = [self._dynamic * (float(m[0]) + self._damping * float(c[0])) for m, c in history]
        kept = [rule.rates(zero, *unit) for unit in units]
        of_old = np.array(kept)[:, :, 0].T
        of_new = np.array(rule.rates(one, zero, zero, zero))
        rates = np.ascontiguousarray(np.hstack([of_old, of_new]))
        return Coefficients(np.array(carry), rates, filtered, forces)

    @property
    def settles(self) -> bool:
        """Whether a step can be taken as two settling halves."""
        return self.rule.settles

    def initial(self) -> ModalMotion:
        """At rest."""
        none = np.zeros((0, self._model.dimension))
        return ModalMotion(np.zeros((3, len(self.eigenvalues))), none, none)

    def predict(self, state: ModalMotion, settling: bool = False) -> ModalPrediction:
        """Move the modes without load at the end of the step (Eq. 4, mode by mode)."""
        rule = self._settling if settling else self._newmark
        u, filtered = unloaded(rule, state.modal, state.filtered, state.forces)
        return ModalPrediction(u, filtered, rule)

    def complete(
        self, state: ModalMotion, prediction: ModalPrediction, table: ResponseTable, forces: Vector
    ) -> ModalMotion:
        """Load the modes and the filter with the contact forces (Eqs. 2 and 3)."""
        begun = state.modal, prediction.u, prediction.filtered
        modal, filtered = loaded(
            prediction.rule, self._dynamic, self._share, table.modal(), forces, begun
        )
        return ModalMotion(modal, filtered, forces)

    def _beyond_static(self, modal: Vector, filtered: Vector, table: ResponseTable) -> Vector:
        """Return what modes (m,) add to the static displacement by filtered forces (n, d)."""
        return np.asarray(modal - self._flexibility * (table.modal() @ filtered.ravel()))

    def at(
        self, step: WithinStep, table: ResponseTable, forces: Vector, reading: Reading
    ) -> Vector:
        """Displacement of a footprint: without contact forces, and what they do to it."""
        acting, share = step.acting(forces), step.share
        modal = (1.0 - share) * step.state.modal[0] + share * step.prediction.u
        modal += self._dynamic * (table.modal() @ acting.ravel())
        filtered = (1.0 - share) * _widened(step.state.filtered, table.count)
        filtered += share * _widened(step.prediction.filtered, table.count)
        filtered += self._share * acting
        modal = self._beyond_static(modal, filtered, table)
        return np.asarray(reading.displacement(filtered) + modal @ reading.shape)

    def at_readers(self, state: ModalMotion, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of the readers."""
        return moved(table.at_readers(), self._at_readers, state.filtered, state.modal[0])

    def everywhere(self, state: ModalMotion, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of all nodes; one solve."""
        filtered = _widened(state.filtered, table.count)
        modal = self._beyond_static(state.modal[0], filtered, table)
        loads = table.spread(filtered).ravel()[self._model.free]
        return expand(self._model, self._factor.solve(loads) + self._shapes @ modal)
