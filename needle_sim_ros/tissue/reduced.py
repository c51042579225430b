# SPDX-License-Identifier: Apache-2.0
"""Newmark's method on the lowest modes, and the massless answer of all others.

The static response holds every mode. The lowest ones are taken out of it and moved with
inertia; the rest, far above the frequencies that a step resolves, keep only stiffness and
the damping beta K. As beta is one number, all of them relax alike, and a filtered force
stands for them (the mode-acceleration method with damped residual modes). A step costs
modes times track points, whatever the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.dynamics import expand
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.newmark import NewmarkRule
from needle_sim_ros.tissue.response import ModalPart, ResponseTable


@dataclass(frozen=True)
class ModalMotion:
    """Modal displacement, velocity, acceleration; filtered forces, (n, d)."""

    u: Vector
    v: Vector
    a: Vector
    filtered: Vector


@dataclass(frozen=True)
class ModalPrediction:
    """Modal displacement and filtered forces at the end of a step without contact forces."""

    u: Vector
    filtered: Vector
    flexibility: Vector

    def rows(self, table: ResponseTable) -> Vector:
        """Return the displacement of the rows of a table, shape (n, d)."""
        filtered = _widened(self.filtered, table.count)
        return _displacement(self.u, filtered, table, self.flexibility)


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


def _displacement(u: Vector, filtered: Vector, table: ResponseTable, flexibility: Vector) -> Vector:
    shapes, force = table.modal(), filtered.ravel()
    modal = u - flexibility * (shapes @ force)
    return np.asarray(table.static() @ force + modal @ shapes).reshape(filtered.shape)


class ReducedNewmark:
    """Second-order dynamics of the lowest modes, massless damped dynamics of the others."""

    def __init__(
        self,
        model: TissueModel,
        factor: Factor,
        compliance: NodalCompliance,
        rule: NewmarkRule,
        count: int,
    ) -> None:
        self._model, self._factor, self.compliance = model, factor, compliance
        self.rule = rule
        self.eigenvalues, shapes = lowest_modes(model, factor, count)
        self._damping = rule.alpha + rule.beta * self.eigenvalues
        stiff = rule.delta / (rule.xi * rule.step)
        self._dynamic = 1.0 / (
            self.eigenvalues + 1.0 / (rule.xi * rule.step**2) + stiff * self._damping
        )
        self._flexibility = 1.0 / self.eigenvalues
        # beta u' + u = C f, exactly for the force of the step: a trapezoid rule would answer
        # every jump of velocity at the contact with a force that alternates for ever
        self._kept = 0.0 if rule.beta == 0 else float(np.exp(-rule.step / rule.beta))
        self._share = 1.0 - self._kept
        nodal = np.stack([expand(model, shape) for shape in shapes.T], axis=2)
        self.modes = ModalPart(nodal, self._dynamic, self._flexibility, self._share)
        self._read_shapes = compliance.reader_matrix @ shapes
        self._shapes = shapes

    def initial(self) -> ModalMotion:
        """At rest."""
        zero, none = np.zeros(len(self.eigenvalues)), np.zeros((0, self._model.dimension))
        return ModalMotion(zero, zero, zero, none)

    def predict(self, state: ModalMotion) -> ModalPrediction:
        """Move the modes without load at the end of the step."""
        inertia, damping = self.rule.history(state.u, state.v, state.a)
        u = self._dynamic * (inertia + self._damping * damping)
        return ModalPrediction(u, self._kept * state.filtered, self._flexibility)

    def complete(
        self, state: ModalMotion, prediction: ModalPrediction, table: ResponseTable, forces: Vector
    ) -> ModalMotion:
        """Load the modes and the filter with the contact forces."""
        u = prediction.u + self._dynamic * (table.modal() @ forces.ravel())
        v, a = self.rule.rates(u, state.u, state.v, state.a)
        filtered = self._share * forces + _widened(prediction.filtered, table.count)
        return ModalMotion(u, v, a, filtered)

    def _modal(self, state: ModalMotion, table: ResponseTable) -> tuple[Vector, Vector]:
        filtered = _widened(state.filtered, table.count)
        static = table.modal() @ filtered.ravel()
        return filtered, state.u - self._flexibility * static

    def at_nodes(
        self, state: ModalMotion, table: ResponseTable, forces: Vector, nodes: Index
    ) -> Vector:
        """Displacement of nodes."""
        filtered, modal = self._modal(state, table)
        static = self.compliance.displacement(table.nodes, table.loads(filtered), nodes)
        return np.asarray(static + self.modes.shapes[nodes] @ modal)

    def at_readers(self, state: ModalMotion, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of the readers."""
        filtered, modal = self._modal(state, table)
        static = table.at_readers() @ filtered.ravel()
        return np.asarray(static + self._read_shapes @ modal)

    def everywhere(self, state: ModalMotion, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of all nodes; one solve."""
        filtered, modal = self._modal(state, table)
        loads = table.spread(filtered).ravel()[self._model.free]
        return expand(self._model, self._factor.solve(loads) + self._shapes @ modal)
