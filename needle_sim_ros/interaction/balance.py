# SPDX-License-Identifier: Apache-2.0
"""The bounded convex problem of a step, set up from compliances (replaces Eqs. 15 to 24).

Unknowns: per track point the lateral forces q_k and the axial friction f_k, and the tip
force c, all on the tissue. With C the compliance of the tissue between the track points,
C_n that of the needle, kappa the presliding stiffness and l_k the inserted length:

- lateral, equality: x_k + u_k lies on the deflected needle;
- friction: f_k / (kappa l_k) + axial u_k = elastic presliding + advance of the needle,
  |f_k| <= limit l_k;
- tip: its face stands on the end of the track, 0 <= c <= cutting or puncture force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact_solve import solve_contact
from needle_sim_ros.interaction.coupling import coverage
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.track import Track
from needle_sim_ros.needle import beam
from needle_sim_ros.scene import Scene

if TYPE_CHECKING:
    from needle_sim_ros.interaction.contact import Step

# inserted length, in track spacings, below which a point carries nothing yet
_LEAST = 1e-6


@dataclass(frozen=True)
class TipLimit:
    """Largest tip force, N, and the length over which the tip spreads it, m."""

    force: float
    spread: float


@dataclass(frozen=True)
class BalanceSolution:
    """Forces and kinematics of a step, the fields as in ContactState.

    Attributes
    ----------
    overlap : float
        How far the tip wants beyond the end of the track (negative: short of it), m.
    slope : ndarray, shape (d - 1,)
        Slopes of the needle at the tip.
    """

    active: int
    lateral: Vector
    friction: Vector
    tip: float
    arclength: Vector
    share: Vector
    strain: Vector
    slip: Vector
    moved: Vector
    forces: Vector
    status: NDArray[np.int8]
    solves: int
    residual: float
    overlap: float
    slope: Vector

    def fields(self) -> dict[str, Any]:
        """Return what goes into the state."""
        return {k: v for k, v in self.__dict__.items() if k not in ("overlap", "slope")}


def coverage_of(track: Track, depth: float) -> Vector:
    """Return the inserted length of every point of a track, m."""
    return coverage(depth, track.count, track.spacing)


class Balance:
    """Sets up and solves the problem of a step.

    Parameters
    ----------
    scene : Scene
    laws : Laws
    """

    def __init__(self, scene: Scene, laws: Laws) -> None:
        self.laws = laws
        self._length = scene.needle.length
        self._rigidity = scene.needle.flexural_rigidity
        self._tolerance = scene.solver.tolerance
        self._tip_at = np.array([self._length])

    def slope(self, state: ContactState) -> Vector:
        """Return the needle's slopes at the tip in a state, shape (d - 1,)."""
        return self._slope(state.arclength, state.lateral)

    def _slope(self, arclength: Vector, lateral: Vector) -> Vector:
        if len(arclength) == 0:
            return np.zeros(len(lateral))
        per_force = beam.slope_flexibility(self._tip_at, arclength, self._rigidity)[0]
        return np.asarray(-(lateral @ per_force))

    def touch(self, track: Track, pose: BasePose, free: Vector, limit: float) -> BalanceSolution:
        """Balance the tip on the unbroken surface: state 3 of Fig. 5 (Eqs. 9 to 11).

        The tip keeps to the point of the surface that it met, so the deflection of an
        inclined needle follows from the same equilibrium (Eqs. 13 and 14).
        """
        m = len(pose.lateral)
        compliance = _in_axes(track.table.between(), np.vstack([pose.lateral, pose.axial]))
        matrix = compliance[:, :, 0, 0].copy()
        bend = beam.flexibility(self._tip_at, self._tip_at, self._rigidity)[0, 0]
        matrix[np.arange(m), np.arange(m)] += bend
        point = track.points[0] + free[:, 0]
        right = np.append(-pose.aside(point), self._length - pose.along(point))
        low = np.append(np.full(m, -np.inf), 0.0)
        high = np.append(np.full(m, np.inf), limit)
        status = np.zeros(m + 1, dtype=np.int8)
        found = solve_contact(matrix, right, low, high, status, self._tolerance)
        lateral, force = found.x[:m, None], float(found.x[m])
        forces = (found.x[:m] @ pose.lateral + force * pose.axial)[:, None]
        between = track.table.between()[:, :, 0, 0]
        return BalanceSolution(
            active=1,
            lateral=lateral,
            friction=np.zeros(1),
            tip=force,
            arclength=self._tip_at,
            share=np.ones(1),
            strain=np.zeros(1),
            slip=np.zeros(1),
            moved=free + between @ forces,
            forces=forces,
            status=np.zeros(0, dtype=np.int8),
            solves=found.iterations,
            residual=float(np.abs(found.gradient[:m]).max()) / max(np.abs(right).max(), 1e-300),
            overlap=-float(found.gradient[m]) if force >= limit else 0.0,
            slope=self._slope(self._tip_at, lateral),
        )

    def inserted(
        self,
        track: Track,
        step: Step,
        moved: Vector,
        strain: Vector,
        slip: Vector,
        status: NDArray[np.int8],
        depth: float,
        limit: TipLimit,
    ) -> BalanceSolution:
        """Balance the inserted needle with its tip at a depth of the track.

        Parameters
        ----------
        track : Track
        step : Step
        moved : ndarray, shape (d, n)
            Displacement of the track points before the step.
        strain, slip : ndarray, shape (previously active,)
        status : ndarray of int8
            Guess of the bounds that hold: friction of each point, and last the tip.
        depth : float
            m.
        limit : TipLimit
        """
        pose, free = step.after, step.free(track.table)
        inserted = coverage_of(track, depth)
        n = max(1, int(np.count_nonzero(inserted > _LEAST * track.spacing)))
        m = len(pose.lateral)
        points, length = track.points[:n], inserted[:n]
        share = self._share(inserted, track, depth, limit.spread)
        arclength = self._length - depth + track.spacing * np.arange(n)
        axes = np.vstack([pose.lateral, pose.axial])
        compliance = _in_axes(track.table.between()[:, :, :n, :n], axes)
        strain, slip = _fitted(strain, n), _fitted(slip, n)
        stiffness = self.laws.interaction.friction.presliding_stiffness
        presliding = 1.0 / (stiffness * np.maximum(length, _LEAST * track.spacing))

        size = m * n + n + 1
        matrix = np.empty((size, size))
        axial = compliance[m]
        for a in range(m):
            rows = slice(a * n, (a + 1) * n)
            for b in range(m):
                matrix[rows, b * n : (b + 1) * n] = compliance[a, b]
            matrix[rows, m * n : -1] = compliance[a, m]
            matrix[m * n : -1, rows] = axial[a]
            matrix[rows, -1] = compliance[a, m] @ share
            matrix[-1, rows] = matrix[rows, -1]
        bend = beam.flexibility(arclength, arclength, self._rigidity)
        ramp = self._ramp(length, track.spacing)
        for a in range(m):
            block = matrix[a * n : (a + 1) * n, a * n : (a + 1) * n]
            own = np.einsum("kk->k", block)
            own += ramp * own
            block += bend
        pressed = axial[m] @ share
        matrix[m * n : -1, m * n : -1] = axial[m]
        np.einsum("kk->k", matrix[m * n : -1, m * n : -1])[...] += presliding
        matrix[m * n : -1, -1] = matrix[-1, m * n : -1] = pressed
        matrix[-1, -1] = share @ pressed + 1e-6 * presliding.min()

        advance = step.advance
        right = np.empty(size)
        where = points.T + free[:, :n]
        right[: m * n] = -(axes[:m] @ (where - pose.origin[:, None])).ravel()
        elastic = strain + advance + pose.axial @ (moved[:, :n] - free[:, :n])
        right[m * n : -1] = elastic
        end = track.at(depth) + free[:, :n] @ share
        right[-1] = self._length - pose.along(end)

        bound = self.laws.friction(track.static[:n], track.kinetic[:n], slip) * length
        low = np.full(size, -np.inf)
        high = np.full(size, np.inf)
        low[m * n : -1], high[m * n : -1] = -bound, bound
        low[-1], high[-1] = 0.0, limit.force
        guess = np.zeros(size, dtype=np.int8)
        guess[m * n :] = _guess(status, n)
        found = solve_contact(matrix, right, low, high, guess, self._tolerance)
        return self._unpacked(
            found, track, pose, free, moved, slip, elastic, presliding, arclength, share, right
        )

    def _unpacked(
        self,
        found: Any,
        track: Track,
        pose: BasePose,
        free: Vector,
        moved: Vector,
        slip: Vector,
        elastic: Vector,
        presliding: Vector,
        arclength: Vector,
        share: Vector,
        right: Vector,
    ) -> BalanceSolution:
        m, n = len(pose.lateral), len(arclength)
        lateral = found.x[: m * n].reshape(m, n)
        friction, force = found.x[m * n : -1], float(found.x[-1])
        forces = np.zeros((len(pose.axial), track.count))
        forces[:, :n] = pose.lateral.T @ lateral + np.outer(pose.axial, friction + force * share)
        between = track.table.between()[:, :, :, :n]
        after = free.copy()
        for a in range(len(after)):
            for b in range(len(after)):
                after[a] += between[a, b] @ forces[b, :n]
        new_strain = presliding * friction
        state = found.status[m * n :]
        slid = elastic - pose.axial @ (after[:, :n] - free[:, :n]) - new_strain
        slipping = (state[:-1] != 0) & (np.abs(slid) > 0)
        unbalanced = found.gradient[found.status == 0]
        scale = max(float(np.abs(right).max()), 1e-300)
        return BalanceSolution(
            active=n,
            lateral=lateral,
            friction=friction,
            tip=force,
            arclength=arclength,
            share=share,
            strain=new_strain,
            slip=np.where(slipping, slip + np.abs(slid), 0.0),
            moved=after,
            forces=forces,
            status=state,
            solves=found.iterations,
            residual=float(np.abs(unbalanced).max(initial=0.0)) / scale,
            overlap=-float(found.gradient[-1]) if state[-1] != 0 else 0.0,
            slope=self._slope(arclength, lateral),
        )

    def _ramp(self, length: Vector, spacing: float) -> Vector:
        """Return how much softer a point is held that the tip has not wholly passed.

        The entry is held from the first; the others come in smoothly with their inserted
        length, so that no force jumps when the track grows.
        """
        ramp = spacing / np.maximum(length, _LEAST * spacing) - 1.0
        ramp[0] = 0.0
        return np.maximum(ramp, 0.0)

    def _share(self, inserted: Vector, track: Track, depth: float, spread: float) -> Vector:
        """Return how the tip force is spread over the last bevel length of the track."""
        n = max(1, int(np.count_nonzero(inserted > _LEAST * track.spacing)))
        share = inserted[:n]
        if depth > spread:
            share = share - coverage(depth - spread, n, track.spacing)
        total = float(share.sum())
        if total <= 1e-3 * track.spacing:
            first = np.zeros(n)
            first[0] = 1.0
            return first
        return np.asarray(share / total)


def _fitted(values: Vector, n: int) -> Vector:
    """Cut or extend with zeros to n entries: points that the tip has not passed know nothing."""
    if len(values) >= n:
        return values[:n]
    return np.concatenate([values, np.zeros(n - len(values))])


def _guess(status: NDArray[np.int8], n: int) -> NDArray[np.int8]:
    """Fit the bounds that held before to n friction forces and the tip."""
    if len(status) == 0:
        return np.zeros(n + 1, dtype=np.int8)
    friction, tip = status[:-1], status[-1:]
    if len(friction) < n:
        last = friction[-1] if len(friction) else 0
        friction = np.append(friction, np.full(n - len(friction), last, dtype=np.int8))
    return np.concatenate([friction[:n], tip])


def _in_axes(compliance: Vector, axes: Vector) -> Vector:
    """Turn a compliance (d, d, n, n) into other axes, the rows of a (d, d) matrix."""
    if np.array_equal(np.abs(axes), np.eye(len(axes))):
        signs = axes.diagonal()
        if (signs == 1).all():
            return compliance
        return np.asarray(compliance * np.multiply.outer(signs, signs)[:, :, None, None])
    return np.einsum("ia,jb,abkl->ijkl", axes, axes, compliance, optimize=True)
