# SPDX-License-Identifier: Apache-2.0
"""The forces between an inserted needle and its track, from compliances.

Most ticks slide: every friction force stands at its limit, as it did the tick before. Then
only the lateral forces are unknown, and the tip's, and a check of the other conditions stands
for the bounded solve; where the check fails, the bounded problem is solved in full.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact_solve import solve_contact
from needle_sim_ros.interaction.lateral_hold import LateralHold, bending
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.tissue.response import ResponseTable


class TrackForces(NamedTuple):
    """Solution, members as in ContactState.

    Attributes
    ----------
    forces : ndarray, shape (n, d)
        All forces on the tissue, mesh coordinates, N.
    moved : ndarray, shape (n, d)
        Displacement by these forces, m.
    strain : ndarray, shape (n,)
        Elastic presliding at the end, m.
    slid : ndarray, shape (n,)
        Slip in the step, m.
    overlap : float
        How far the tip wants beyond the end of the track, m; 0 where its force is free.
    lack : float
        How far back a tip that bears less than its limit would bear it, by the compliance at
        the tip alone, m.
    residual : float
        Largest violation of equilibrium, relative to the largest gap.
    """

    lateral: Vector
    friction: Vector
    tip: float
    forces: Vector
    moved: Vector
    strain: Vector
    slid: Vector
    status: NDArray[np.int8]
    overlap: float
    residual: float
    solves: int
    lack: float = 0.0


@dataclass(eq=False, slots=True)
class SlidingProblem:
    """Minimise the complementary energy over the forces, within their bounds.

    n rows of the track carry friction, the first k of them are held laterally.

    Attributes
    ----------
    pose : BasePose
    table : ResponseTable
        Compliance of the tissue between the points of the track.
    arclength : ndarray, shape (k,)
        Of the held points, falling distance to the tip, m.
    softness : ndarray, shape (k,)
        Of the hold near the tip, m/N.
    presliding : ndarray, shape (n,)
        Of the elastic presliding, m/N.
    share : ndarray, shape (n,)
        How the tip force is spread.
    tip_softness : float
        Of the tip itself, m/N.
    free : ndarray, shape (k, d)
        Where the held points would be without forces, m.
    elastic : ndarray, shape (n,)
        Presliding that would be without forces, m.
    reach : float
        How far the tip would be beyond the end of the track without forces, m.
    tip_bound : float
        Limit of the tip force, N.
    rigidity : float
        E I of the needle, N m^2.
    tolerance : float
        Relative tolerance of the conditions.
    """

    pose: BasePose
    table: ResponseTable
    arclength: Vector
    softness: Vector
    presliding: Vector
    share: Vector
    tip_softness: float
    free: Vector
    elastic: Vector
    reach: float
    tip_bound: float
    rigidity: float
    tolerance: float

    def sliding(
        self, hold: LateralHold, friction: Vector, status: NDArray[np.int8]
    ) -> TrackForces | None:
        """Solve with friction at guessed bounds; None if they do not hold.

        Forces and displacements are linear in the tip force then: where neither of its bounds
        holds, what the tip wants at both tells where it wants nothing.

        Parameters
        ----------
        hold : LateralHold
            Of the held points.
        friction : ndarray, shape (n,)
            At its limits, N.
        status : ndarray of int8, shape (n + 1,)
            Which bounds these are, none of them 0; and last a guess of the tip's.
        """
        allowed = self.tolerance * max(float(self.elastic.max()), abs(self.reach))
        state, bound = (-1, 0.0) if status[-1] < 0 else (1, self.tip_bound)
        solves, found = 1, self._pushed(hold, friction, bound)
        if state * found.overlap < -allowed:
            state, bound, first = -state, self.tip_bound - bound, found
            solves, found = 2, self._pushed(hold, friction, bound)
            if state * found.overlap < -allowed:
                part = found.overlap / (found.overlap - first.overlap)
                solves, tip = 3, bound + part * (first.tip - bound)
                state, found = 0, self._pushed(hold, friction, tip)
                if abs(found.overlap) > allowed:
                    return None
        if float((found.slid * status[:-1]).min()) < -allowed:
            return None
        if state != status[-1]:
            status = status.copy()
            status[-1] = state
        found = found._replace(status=status, solves=solves)
        if state == 0:
            found = found._replace(overlap=0.0)
        if state > 0 or self.tip_bound == 0:
            return found
        m, n = len(self.pose.lateral), len(friction)
        pressed = self._component(m, m, n, n)
        softest = float(self.share @ pressed @ self.share) + self.tip_softness
        return found._replace(lack=self._lack(found.tip, softest, found.overlap))

    def _lack(self, tip: float, softest: float, overlap: float) -> float:
        """Return how far back a tip would bear its limit; one without force is off it besides."""
        return max(0.0, self.tip_bound - tip) * softest - overlap

    def _pushed(self, hold: LateralHold, friction: Vector, tip: float) -> TrackForces:
        """Return what friction and a tip force come to; whether they may be is not looked at."""
        pose, k = self.pose, len(self.arclength)
        axial = tip * self.share
        axial += friction
        right = (pose.origin - self.free) @ pose.lateral.T
        for a, gap in enumerate(right.T):
            gap -= self._component(a, len(pose.lateral), k, len(axial)) @ axial
        lateral = hold.forces(right.T.ravel(), self.arclength, self.softness).reshape(-1, k)
        forces = axial[:, None] * pose.axial
        forces[:k] += lateral.T @ pose.lateral
        moved = (self.table.between(len(axial)) @ forces.ravel()).reshape(forces.shape)
        along = moved @ pose.axial
        strain = self.presliding * friction
        slid = self.elastic - along
        slid -= strain
        overlap = self.reach - float(self.share @ along) - self.tip_softness * tip
        none = np.empty(0, dtype=np.int8)
        return TrackForces(
            lateral, friction, tip, forces, moved, strain, slid, none, overlap, 0.0, 1
        )

    def _component(self, u: int, v: int, rows: int, columns: int) -> Vector:
        """Return the compliance along axis u of the first rows per force along axis v."""
        return self.table.along(self.pose.terms, u, v)[:rows, :columns]

    def bounded(self, low: Vector, high: Vector, status: NDArray[np.int8]) -> TrackForces:
        """Solve the bounded problem in full.

        Parameters
        ----------
        low, high : ndarray, shape (n,)
            Friction limits against and along the axis, N.
        status : ndarray of int8, shape (n + 1,)
            Guess of the bounds that hold: friction, and last the tip.
        """
        pose, k, n = self.pose, len(self.arclength), len(high)
        m = len(pose.lateral)
        wide = m * k
        size = wide + n + 1
        matrix = np.empty((size, size))
        bend = bending(self.arclength, self.softness, self.rigidity)
        bend = np.maximum(bend, bend.T)
        axial = self._component(m, m, n, n)
        pressed = axial @ self.share
        for a in range(m):
            rows = slice(a * k, (a + 1) * k)
            for b in range(m):
                block = self._component(a, b, k, k)
                matrix[rows, b * k : (b + 1) * k] = block + bend if a == b else block
            mixed = self._component(a, m, k, n)
            matrix[rows, wide:-1] = mixed
            matrix[wide:-1, rows] = mixed.T
            matrix[rows, -1] = matrix[-1, rows] = mixed @ self.share
        matrix[wide:-1, wide:-1] = axial
        matrix.reshape(-1)[wide * (size + 1) : -1 : size + 1] += self.presliding
        matrix[wide:-1, -1] = matrix[-1, wide:-1] = pressed
        matrix[-1, -1] = self.share @ pressed + self.tip_softness
        aside = (pose.origin - self.free) @ pose.lateral.T
        right = np.concatenate([aside.T.ravel(), self.elastic, [self.reach]])
        free = np.full(wide, np.inf)
        low = np.concatenate([-free, low, [0.0]])
        high = np.concatenate([free, high, [self.tip_bound]])
        guess = np.concatenate([np.zeros(wide, dtype=np.int8), status])
        found = solve_contact(matrix, right, low, high, guess, self.tolerance)
        state = found.status[wide:]
        loose = found.gradient[found.status == 0]
        scale = max(float(np.abs(right).max()), 1e-300)
        overlap = -float(found.gradient[-1]) if state[-1] != 0 else 0.0
        lateral, friction, tip = found.x[:wide], found.x[wide:-1], float(found.x[-1])
        lateral = lateral.reshape(m, k)
        forces = np.multiply.outer(friction + tip * self.share, pose.axial)
        forces[:k] += lateral.T @ pose.lateral
        moved = (self.table.between(n) @ forces.ravel()).reshape(forces.shape)
        strain = self.presliding * friction
        return TrackForces(
            lateral,
            friction,
            tip,
            forces,
            moved,
            strain,
            self.elastic - moved @ pose.axial - strain,
            state,
            overlap,
            float(np.abs(loose).max(initial=0.0)) / scale,
            found.iterations,
            self._lack(tip, float(matrix[-1, -1]), overlap) if state[-1] <= 0 else 0.0,
        )
