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

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact_solve import solve_contact
from needle_sim_ros.interaction.coupling import coverage
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.sliding import SlidingProblem, TrackForces
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.track import Track
from needle_sim_ros.needle import beam, tip
from needle_sim_ros.scene import Scene

if TYPE_CHECKING:
    from needle_sim_ros.interaction.contact import Step

# inserted length, in track spacings, below which a point carries nothing yet
_LEAST = 1e-6
# advances up to this, m, count as a hold
STILL = 1e-12


class TipLimit(NamedTuple):
    """Largest tip force, N, and the length over which the tip spreads it, m."""

    force: float
    spread: float


class BalanceSolution(NamedTuple):
    """Forces and kinematics of a step, the fields as in ContactState.

    Attributes
    ----------
    overlap : float
        How far the tip wants beyond the end of the track (negative: short of it), m.
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

    def fields(self) -> dict[str, Any]:
        """Return what goes into the state."""
        fields = self._asdict()
        del fields["overlap"]
        return fields


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
        bevel = max(tip.bevel_length(scene.needle), scene.needle.radius)
        width = tissue.thickness / bevel if scene.dimension == 2 else 1.0
        self._grip = tissue.youngs_modulus * width

    def slope(self, bent: ContactState | BalanceSolution) -> Vector:
        """Return the needle's slopes at the tip, shape (d - 1,)."""
        arclength, lateral = bent.arclength, bent.lateral
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
        between = track.table.between(1)
        axes = np.vstack([pose.lateral, pose.axial])
        matrix = axes @ between @ axes.T
        bend = beam.flexibility(self._tip_at, self._tip_at, self._rigidity)[0, 0]
        matrix[np.arange(m), np.arange(m)] += bend
        point = track.points[0] + free[0]
        right = np.append(-pose.aside(point), self._length - pose.along(point))
        low = np.append(np.full(m, -np.inf), 0.0)
        high = np.append(np.full(m, np.inf), limit)
        status = np.zeros(m + 1, dtype=np.int8)
        found = solve_contact(matrix, right, low, high, status, self._tolerance)
        lateral, force = found.x[:m, None], float(found.x[m])
        forces = (found.x[:m] @ pose.lateral + force * pose.axial)[None, :]
        return BalanceSolution(
            active=1,
            lateral=lateral,
            friction=np.zeros(1),
            tip=force,
            arclength=self._tip_at,
            share=np.ones(1),
            strain=np.zeros(1),
            slip=np.zeros(1),
            moved=free + track.table.displacement(forces),
            forces=forces,
            status=np.zeros(0, dtype=np.int8),
            solves=found.iterations,
            residual=float(np.abs(found.gradient[:m]).max()) / max(np.abs(right).max(), 1e-300),
            overlap=-float(found.gradient[m]) if force >= limit else 0.0,
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
        moved : ndarray, shape (n, d)
            Displacement of the track points before the step.
        strain, slip : ndarray, shape (previously active,)
        status : ndarray of int8
            Guess of the bounds that hold: friction of each point, and last the tip.
        depth : float
            m.
        limit : TipLimit
        """
        pose, free = step.after, step.free(track.table)
        h, m = track.spacing, len(pose.lateral)
        last = min(int(depth / h), track.count - 2)  # the last point that the tip has passed
        n = last + 2  # rows: the points passed and the one ahead of the tip
        behind: Vector = depth - h * np.arange(
            last + 1, dtype=float
        )  # the tip is so far beyond each point
        held = max(1, last + (behind[-1] > _LEAST * h))
        length = coverage(depth, n, h)
        share = tip_share(length, depth, limit.spread, h)
        slip, strain = _fitted(slip, n), _fitted(strain, n)
        guess = _guess(status, n)
        low, high = self._limits(track, slip, strain, guess[:-1], step.advance)
        stiffness = self.laws.interaction.friction.presliding_stiffness
        soft = np.zeros(held)
        soft[1:] = self._softness(track, behind[1:held], limit.spread)
        end = track.at(depth) + share @ free[:n] - pose.origin
        problem = SlidingProblem(
            pose=pose,
            between=track.table.between(n),
            arclength=self._length - behind[:held],
            softness=soft,
            presliding=1.0 / (stiffness * np.maximum(length, _LEAST * h)),
            share=share,
            tip_softness=1e-6 / (stiffness * h),
            aside=((pose.origin - track.points[:held] - free[:held]) @ pose.lateral.T).T.ravel(),
            elastic=strain + (step.advance + (moved[:n] - free[:n]) @ pose.axial),
            reach=self._length - float(pose.axial @ end),
            low=-low * length,
            high=high * length,
            tip_bound=limit.force,
            rigidity=self._rigidity,
            tolerance=self._tolerance,
        )
        found = problem.solve(guess)

        lateral = found.lateral.reshape(m, held)
        forces = found.forces
        if n < track.count:
            forces = np.zeros_like(track.points)
            forces[:n] = found.forces
            after = free + track.table.displacement(found.forces)
        else:
            after = free + found.moved
        new_strain = problem.presliding * found.friction
        slid = problem.elastic - found.moved @ pose.axial
        slid -= new_strain
        return BalanceSolution(
            active=n,
            lateral=lateral,
            friction=found.friction,
            tip=found.tip,
            arclength=problem.arclength,
            share=share,
            strain=new_strain,
            slip=self._slip(slip, strain, found, problem, slid, step.advance),
            moved=after,
            forces=forces,
            status=found.status,
            solves=found.solves,
            residual=found.residual,
            overlap=found.overlap,
        )

    def _limits(
        self,
        track: Track,
        slip: Vector,
        strain: Vector,
        status: NDArray[np.int8],
        advance: float,
    ) -> tuple[Vector, Vector]:
        """Return the friction limits of a step per length, back and forth, N/m, shapes (n,).

        What slides goes on sliding by the advance of the needle; what turns round has to
        stick first, so that in the other direction the static limit stands.
        """
        n = len(slip)
        static, kinetic = track.static[:n], track.kinetic[:n]
        onward = np.where(status * advance > 0, abs(advance), 0.0)
        along = self.laws.friction(static, kinetic, slip + onward)
        return np.where(strain > 0, static, along), np.where(strain < 0, static, along)

    def _slip(
        self,
        slip: Vector,
        strain: Vector,
        found: TrackForces,
        problem: SlidingProblem,
        slid: Vector,
        advance: float,
    ) -> Vector:
        """Return the slip since the points last stuck, m.

        A point that sticks in a hold starts anew. While the needle moves it does so as far
        as it is unloaded, and wholly where the friction turns round: whether it stuck for
        the length of a tick must not matter.
        """
        sliding = found.status[:-1] != 0
        turned = found.friction * strain < 0
        after = np.where(turned, 0.0, slip)
        after[sliding] += np.abs(slid[sliding])
        if not sliding.all():
            if abs(advance) <= STILL:
                after[~sliding] = 0.0
            else:
                whole = self.laws.interaction.friction.weakening_distance
                bound = np.where(found.friction > 0, problem.high, -problem.low)
                loaded = whole * np.abs(found.friction) / np.maximum(bound, 1e-300)
                np.minimum(after, loaded, out=after, where=~sliding)
        return after

    def _softness(self, track: Track, behind: Vector, bevel: float) -> Vector:
        """Return how much softer the needle holds track points near its tip, m/N.

        The bevel thins the needle to nothing at the tip: there it holds the tissue
        sideways not at all, and wholly one bevel length behind. The density of the
        lateral force then has no peak at the tip that only the track spacing bounds.
        """
        soft = (bevel / (self._grip * track.spacing)) / behind
        soft -= 1.0 / (self._grip * track.spacing)
        return np.maximum(soft, 0.0, out=soft)


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
    """Cut or extend to n entries: the needle slides by a new point as by the last one."""
    if len(values) >= n:
        return values[:n]
    wider = np.full(n, values[-1] if len(values) else 0.0)
    wider[: len(values)] = values
    return wider


def _guess(status: NDArray[np.int8], n: int) -> NDArray[np.int8]:
    """Fit the bounds that held before to n friction forces and the tip."""
    if len(status) == 0:
        return np.zeros(n + 1, dtype=np.int8)
    friction, tip = status[:-1], status[-1:]
    if len(friction) < n:
        last = friction[-1] if len(friction) else 0
        friction = np.append(friction, np.full(n - len(friction), last, dtype=np.int8))
    return np.concatenate([friction[:n], tip])
