# SPDX-License-Identifier: Apache-2.0
"""Newmark's method (Eqs. 1 to 4) on every unknown of the tissue.

Eq. (4) as printed multiplies C on the left by 1 / (xi dt); Eqs. (2) and (3) give
delta / (xi dt), which is what stands here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.compliance import NodalCompliance
from needle_sim_ros.tissue.dynamics import WithinStep, expand
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.response import Reading, ResponseTable


@dataclass(frozen=True)
class NewmarkRule:
    """The coefficients of a time step.

    Parameters
    ----------
    step : float
        dt, s.
    delta, xi : float
        Newmark's parameters; 0.5 and 0.25 neither damp nor grow.
    alpha, beta : float
        Rayleigh damping C = alpha M + beta K.
    """

    step: float
    delta: float
    xi: float
    alpha: float
    beta: float

    @classmethod
    def of(cls, scene: Scene) -> NewmarkRule:
        """Take the coefficients of a scene."""
        solver, damping = scene.solver, scene.tissue.damping
        return cls(
            solver.time_step, solver.newmark.delta, solver.newmark.xi, damping.alpha, damping.beta
        )

    def settling(self) -> SettlingRule:
        """Return the rule of half a step that damps what rings."""
        return SettlingRule(self.step, self.delta, self.xi, self.alpha, self.beta)

    @property
    def settles(self) -> bool:
        """Whether halves by :class:`SettlingRule` share the matrix; damping pairs need none."""
        return abs(self.delta**2 - self.xi) < 1e-12

    @property
    def stiffness_factor(self) -> float:
        """Factor of K in the effective matrix: 1 + beta delta / (xi dt)."""
        return 1.0 + self.beta * self.delta / (self.xi * self.step)

    @property
    def mass_factor(self) -> float:
        """Factor of M in the effective matrix: 1 / (xi dt^2) + alpha delta / (xi dt)."""
        inertia = 1.0 / (self.xi * self.step**2)
        return inertia + self.alpha * self.delta / (self.xi * self.step)

    def history(self, u: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector]:
        """Return what M and what C multiply on the right of Eq. (4)."""
        dt, delta, xi = self.step, self.delta, self.xi
        inertia = u / (xi * dt**2) + v / (xi * dt) + (0.5 / xi - 1.0) * a
        damping = delta / (xi * dt) * u + (delta / xi - 1.0) * v + (0.5 * delta / xi - 1.0) * dt * a
        return inertia, damping

    def rates(self, new: Vector, u: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector]:
        """Return velocity and acceleration at the end of the step (Eqs. 3 and 2)."""
        dt, delta, xi = self.step, self.delta, self.xi
        after = (new - u) / (xi * dt**2) - v / (xi * dt) - (0.5 / xi - 1.0) * a
        return v + dt * ((1.0 - delta) * a + delta * after), after


class SettlingRule(NewmarkRule):
    """Half a step by the backward Euler method, which forgets what Newmark's keeps ringing.

    Where the base's velocity jumps, so does that of the tissue that sticks to the needle.
    With delta = 0.5 the answer to a jump alternates from step to step and does not die
    away; two such halves in place of one step damp it (Rannacher 1984), and their matrix
    is the one of the whole step: K + M / (dt/2)^2 + C / (dt/2).
    """

    def history(self, u: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector]:
        """Return what M and what C multiply on the right."""
        half = 0.5 * self.step
        return u / half**2 + v / half, u / half

    def rates(self, new: Vector, u: Vector, v: Vector, a: Vector) -> tuple[Vector, Vector]:
        """Return velocity and acceleration at the end of the half step."""
        half = 0.5 * self.step
        rate = (new - u) / half
        return rate, (rate - v) / half


@dataclass(frozen=True)
class Motion:
    """Displacement, velocity and acceleration of the free unknowns."""

    u: Vector
    v: Vector
    a: Vector


@dataclass(frozen=True)
class FreeMotion:
    """Displacement at the end of the step without contact forces, and how it changes."""

    change: Vector
    nodal: Vector
    rule: NewmarkRule

    def rows(self, table: ResponseTable) -> Vector:
        """Sample it at the rows of a table."""
        return table.sample(self.nodal)


def effective_matrix(model: TissueModel, rule: NewmarkRule) -> sp.csr_array:
    """Return K + M / (xi dt^2) + C delta / (xi dt), the matrix of Eq. (4)."""
    return sp.csr_array(rule.stiffness_factor * model.stiffness + rule.mass_factor * model.mass)


class FullNewmark:
    """Second-order dynamics of all unknowns: two solves a step, the accurate reference."""

    modes = None

    def __init__(
        self, model: TissueModel, factor: Factor, compliance: NodalCompliance, rule: NewmarkRule
    ) -> None:
        self._model, self._factor, self.compliance = model, factor, compliance
        self.rule, self._settling = rule, rule.settling()
        self._readers = compliance.reader_matrix

    @property
    def settles(self) -> bool:
        """Whether a step can be taken as two settling halves."""
        return self.rule.settles

    def initial(self) -> Motion:
        """At rest."""
        zero = np.zeros(len(self._model.free))
        return Motion(zero, zero, zero)

    def predict(self, state: Motion, settling: bool = False) -> FreeMotion:
        """Solve Eq. (4) with no load at the end of the step."""
        rule = self._settling if settling else self.rule
        if not (state.u.any() or state.v.any() or state.a.any()):
            return FreeMotion(state.u, expand(self._model, state.u), rule)
        # for the change, not the displacement: velocities are differences by the time step,
        # and those of displacements that are known to rounding only would be noise
        inertia, damping = rule.history(np.zeros_like(state.u), state.v, state.a)
        load = self._model.mass @ (inertia + self.rule.alpha * damping)
        load += self._model.stiffness @ (self.rule.beta * damping - state.u)
        change = self._factor.solve(load)
        return FreeMotion(change, expand(self._model, state.u + change), rule)

    def complete(
        self, state: Motion, prediction: FreeMotion, table: ResponseTable, forces: Vector
    ) -> Motion:
        """Add the response to the contact forces and update the rates."""
        change = prediction.change
        if forces.any():
            loads = table.spread(forces).ravel()[self._model.free]
            change = change + self._factor.solve(loads)
        v, a = prediction.rule.rates(change, np.zeros_like(change), state.v, state.a)
        return Motion(state.u + change, v, a)

    def at(
        self, step: WithinStep, table: ResponseTable, forces: Vector, reading: Reading
    ) -> Vector:
        """Displacement of a footprint: without contact forces, and what they do to it."""
        nodes, weights = reading.footprint.nodes, reading.footprint.weights
        free = expand(self._model, step.state.u)
        free *= 1.0 - step.share
        free += step.share * step.prediction.nodal
        return np.asarray(weights @ free[nodes] + reading.displacement(step.acting(forces)))

    def at_readers(self, state: Motion, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of the readers."""
        return np.asarray(self._readers @ state.u + table.read_beyond_mesh(forces))

    def everywhere(self, state: Motion, table: ResponseTable, forces: Vector) -> Vector:
        """Displacement of all nodes."""
        return expand(self._model, state.u)

    def energy(self, state: Motion) -> float:
        """Return kinetic and elastic energy, J."""
        model = self._model
        return float(
            0.5 * state.v @ (model.mass @ state.v) + 0.5 * state.u @ (model.stiffness @ state.u)
        )
