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
        tissue = scene.tissue
        # lateral stiffness of the tissue per length of needle, N/m per m
        self._grip = tissue.youngs_modulus * (tissue.thickness if scene.dimension == 2 else 1.0)

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
        h, m = track.spacing, len(step.after.lateral)
        last = min(int(depth / h), track.count - 2)  # the last point that the tip has passed
        n = last + 2  # rows: the points passed and the one ahead of the tip
        behind = depth - h * np.arange(last + 1)  # the tip is so far beyond each point
        held = max(1, int(np.count_nonzero(behind > _LEAST * h)))
        length = coverage(depth, n, h)
        share = tip_share(length, depth, limit.spread, h)
        arclength = self._length - behind[:held]
        axes = np.vstack([pose.lateral, pose.axial])
        compliance = _in_axes(track.table.between()[:, :, :n, :n], axes)
        strain, slip = _fitted(strain, n), _fitted(slip, n)
        stiffness = self.laws.interaction.friction.presliding_stiffness
        presliding = 1.0 / (stiffness * np.maximum(length, _LEAST * h))

        wide = m * held
        matrix = np.empty((wide + n + 1, wide + n + 1))
        bend = beam.flexibility(arclength, arclength, self._rigidity)
        np.einsum("kk->k", bend)[1:] += self._softness(track, behind[1:held], limit.spread)
        axial = compliance[m, m]
        pressed = axial @ share
        for a in range(m):
            rows = slice(a * held, (a + 1) * held)
            for b in range(m):
                matrix[rows, b * held : (b + 1) * held] = compliance[a, b, :held, :held]
            matrix[rows, rows] += bend
            matrix[rows, wide:-1] = compliance[a, m, :held]
            matrix[wide:-1, rows] = compliance[m, a, :, :held]
            matrix[rows, -1] = matrix[-1, rows] = compliance[a, m, :held] @ share
        matrix[wide:-1, wide:-1] = axial
        np.einsum("kk->k", matrix[wide:-1, wide:-1])[...] += presliding
        matrix[wide:-1, -1] = matrix[-1, wide:-1] = pressed
        matrix[-1, -1] = share @ pressed + 1e-6 / (stiffness * h)

        right = np.empty(wide + n + 1)
        where = track.points[:held].T + free[:, :held]
        right[:wide] = -(pose.lateral @ (where - pose.origin[:, None])).ravel()
        elastic = strain + step.advance + pose.axial @ (moved[:, :n] - free[:, :n])
        right[wide:-1] = elastic
        right[-1] = self._length - pose.along(track.at(depth) + free[:, :n] @ share)

        bound = self.laws.friction(track.static[:n], track.kinetic[:n], slip) * length
        low = np.full(wide + n + 1, -np.inf)
        high = np.full(wide + n + 1, np.inf)
        low[wide:-1], high[wide:-1] = -bound, bound
        low[-1], high[-1] = 0.0, limit.force
        guess = np.zeros(wide + n + 1, dtype=np.int8)
        guess[wide:] = _guess(status, n)
        found = solve_contact(matrix, right, low, high, guess, self._tolerance)

        lateral = found.x[:wide].reshape(m, held)
        friction, force = found.x[wide:-1], float(found.x[-1])
        forces = np.zeros((len(pose.axial), track.count))
        forces[:, :held] = pose.lateral.T @ lateral
        forces[:, :n] += np.outer(pose.axial, friction + force * share)
        after = free + displaced(track, forces, n)
        new_strain = presliding * friction
        state = found.status[wide:]
        slid = elastic - pose.axial @ (after[:, :n] - free[:, :n]) - new_strain
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
            slip=np.where(state[:-1] != 0, slip + np.abs(slid), 0.0),
            moved=after,
            forces=forces,
            status=state,
            solves=found.iterations,
            residual=float(np.abs(unbalanced).max(initial=0.0)) / scale,
            overlap=-float(found.gradient[-1]) if state[-1] != 0 else 0.0,
            slope=self._slope(arclength, lateral),
        )

    def _softness(self, track: Track, behind: Vector, bevel: float) -> Vector:
        """Return how much softer the needle holds track points near its tip, m/N.

        The bevel thins the needle to nothing at the tip: there it holds the tissue
        sideways not at all, and wholly one bevel length behind. The density of the
        lateral force then has no peak at the tip that only the track spacing bounds.
        """
        grip = self._grip * track.spacing
        return np.maximum(bevel / behind - 1.0, 0.0) / grip


def displaced(track: Track, forces: Vector, active: int) -> Vector:
    """Return the displacement of all track points by forces on the first ones, (d, n), m."""
    between = track.table.between()[:, :, :, :active]
    moved = np.zeros_like(forces)
    for a in range(len(moved)):
        for b in range(len(moved)):
            moved[a] += between[a, b] @ forces[b, :active]
    return moved


def tip_share(length: Vector, depth: float, spread: float, spacing: float) -> Vector:
    """Return how the tip force is spread over the last bevel length of the track.

    Parameters
    ----------
    length : ndarray, shape (n,)
        Inserted length that each point carries, m.
    depth, spread, spacing : float
        Depth of the tip, bevel length, track spacing, m.
    """
    share = length
    if depth > spread:
        share = share - coverage(depth - spread, len(length), spacing)
    total = float(share.sum())
    if total <= _LEAST * spacing:
        first = np.zeros(len(length))
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
