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

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction import compiled_balance, friction
from needle_sim_ros.interaction.friction import FrictionMemory, FrictionStart
from needle_sim_ros.interaction.lateral_hold import LateralHold
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.sliding import SlidingProblem, TrackForces
from needle_sim_ros.interaction.solution import BalanceSolution
from needle_sim_ros.interaction.spreading import LEAST, coverage, tip_share
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.step import Step
from needle_sim_ros.interaction.task import InsertedTask
from needle_sim_ros.interaction.track import Track
from needle_sim_ros.needle import beam, tip
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.response import ResponseTable

# Compliance of the tip's own contact, of what tissue of the bevel's size has. Points that
# stick within the bevel fix the tip's place too: with a rigid tip the presliding, however
# stiff, would decide how tip and friction share the load.
_TIP_SOFTNESS = 0.03


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
        self._tip_bend = float(beam.flexibility(self._tip_at, self._tip_at, self._rigidity)[0, 0])
        spacing = scene.solver.track_spacing
        self._places = spacing * np.arange(3.0 + self._length / spacing)
        tissue = scene.tissue
        # lateral stiffness of the tissue per length of needle, N/m per m
        bevel = tip.spread_length(scene.needle)
        width = tissue.thickness / bevel if scene.dimension == 2 else 1.0
        self._grip = tissue.youngs_modulus * width
        self._tip_softness = _TIP_SOFTNESS / (self._grip * bevel)
        self._spacing, self._bevel = spacing, bevel
        self._hold: LateralHold | None = None
        self._compiled = None
        if compiled_balance.available():
            constants = (bevel, self._grip, self._tip_softness)
            self._compiled = compiled_balance.CompiledBalance(scene, *constants)

    def dent(self, force: float) -> float:
        """Return how far a tip force, N, presses the tip into its own contact, m."""
        return self._tip_softness * force

    def slope(self, bent: ContactState | BalanceSolution) -> Vector:
        """Return the needle's slopes at the tip, shape (d - 1,)."""
        arclength, lateral = bent.arclength, bent.lateral
        if len(arclength) == 0:
            return np.zeros(len(lateral))
        return np.asarray(-(lateral @ beam.tip_slope_flexibility(arclength, self._rigidity)))

    def touch(self, track: Track, step: Step, limit: float) -> BalanceSolution:
        """Balance the tip on the unbroken surface: state 3 of Fig. 5 (Eqs. 9 to 11).

        The tip keeps to the point of the surface that it met, so the deflection of an
        inclined needle follows from the same equilibrium (Eqs. 13 and 14).
        """
        pose, free = step.after, step.free(track.table)
        m = len(pose.lateral)
        axes = np.concatenate([pose.lateral, pose.axial[None]])
        matrix = (step.yielding * axes) @ track.table.between(1) @ axes.T
        matrix.reshape(-1)[: m * (m + 2) : m + 2] += self._tip_bend
        point = track.points[0] + free[0]
        aside, reach = -pose.aside(point), self._length - pose.along(point)
        # one force is bounded: the others follow it
        cross, softness = matrix[:m, m], matrix[m, m]
        alone, with_it = np.linalg.solve(matrix[:m, :m], np.stack([aside, cross], axis=1)).T
        softness -= cross @ with_it
        wanted = float((reach - cross @ alone) / softness)
        force = min(max(wanted, 0.0), limit)
        lateral = alone - force * with_it
        forces = (lateral @ pose.lateral + force * pose.axial)[None, :]
        left = matrix[:m, :m] @ lateral + force * cross - aside
        return BalanceSolution(
            active=1,
            lateral=lateral[:, None],
            friction=np.zeros(1),
            tip=force,
            arclength=self._tip_at,
            softness=np.zeros(1),
            share=np.ones(1),
            strain=np.zeros(1),
            slip=np.zeros(1),
            slid=np.zeros(1),
            advance=0.0,
            lasted=0.0,
            moved=free + track.table.displacement(step.yielding * forces),
            forces=forces,
            status=np.zeros(0, dtype=np.int8),
            solves=1,
            residual=float(np.abs(left).max()) / max(np.abs(aside).max(), abs(reach), 1e-300),
            overlap=float((wanted - force) * softness) if force >= limit else 0.0,
        )

    def inserted(
        self,
        track: Track,
        step: Step,
        moved: Vector,
        memory: FrictionMemory,
        status: NDArray[np.int8],
        depth: float,
        limit: float,
    ) -> BalanceSolution:
        """Balance the inserted needle with its tip at a depth of the track.

        Parameters
        ----------
        track : Track
        step : Step
        moved : ndarray, shape (n, d)
            Displacement of the track points before the step.
        memory : FrictionMemory
            Of the step before.
        status : ndarray of int8
            Guess of the bounds that hold: friction of each point, and last the tip.
        depth : float
            m.
        limit : float
            Largest tip force, N.
        """
        h = track.spacing
        last = min(int(depth / h), track.laid - 2)  # the last point that the tip has passed
        bounds = friction.guess(status, last + 2)  # rows: the points passed and the one ahead
        held = max(1, last + (depth - h * last > LEAST * h))
        stuck = 0 in bounds[:-1].tobytes()
        hold, free = None, step.free(track.table)
        if step.yielding != 1.0:
            track = track._replace(table=track.table.yielding(step.yielding))
        elif not stuck:
            hold = self._hold_of(track.table, step, depth, held)
        reach = self._length + track.dent - step.after.reach(track.place(depth))
        task = InsertedTask(
            track, step, free, moved, memory, bounds, depth, held, hold, reach, limit
        )
        found = self._compiled.solve(self.laws, task) if self._compiled else None
        return found or self._solve(task)

    def _solve(self, task: InsertedTask) -> BalanceSolution:
        track, step, free, moved, memory, bounds, depth, held, *_ = task
        pose, h = step.after, track.spacing
        n = len(bounds) - 1
        length = coverage(depth, n, h)
        share = tip_share(length, depth, self._bevel, h)
        start = FrictionStart.of(track, memory, bounds, step.advance, step.duration)
        stiffness = self.laws.interaction.friction.presliding_stiffness
        presliding = np.maximum(length, LEAST * h)
        presliding *= stiffness
        np.reciprocal(presliding, out=presliding)
        along = free[:n] @ pose.axial
        elastic = moved[:n] @ pose.axial
        elastic -= along
        elastic += step.advance
        elastic += start.strain
        problem = SlidingProblem(
            pose=pose,
            table=track.table,
            arclength=self._places[:held] + (self._length - depth),
            softness=self._softness(depth, held),
            presliding=presliding,
            share=share,
            tip_softness=self._tip_softness,
            free=track.points[:held] + free[:held],
            elastic=elastic,
            reach=task.reach - float(share @ along),
            tip_bound=task.limit,
            rigidity=self._rigidity,
            tolerance=self._tolerance,
        )
        found, slipped = self._solved(problem, start, length, task)

        forces = found.forces
        if n < track.laid:
            forces = np.zeros_like(track.points)
            forces[:n] = found.forces
            after = free + track.table.displacement(found.forces)
        else:
            after = free + found.moved
        return BalanceSolution(
            active=n,
            lateral=found.lateral,
            friction=found.friction,
            tip=found.tip,
            arclength=problem.arclength,
            softness=problem.softness,
            share=share,
            strain=found.strain,
            slip=slipped,
            slid=found.slid,
            advance=step.advance,
            lasted=step.duration,
            moved=after,
            forces=forces,
            status=found.status,
            solves=found.solves,
            residual=found.residual,
            overlap=found.overlap,
            lack=found.lack,
        )

    def _solved(
        self, problem: SlidingProblem, start: FrictionStart, length: Vector, task: InsertedTask
    ) -> tuple[TrackForces, Vector]:
        """Solve for the forces; return them and the slip that counts."""
        found = self._found(problem, start, length, task.hold, task.status)
        slipped = friction.slip_after(
            self.laws, start.slip, found.status[:-1], found.slid, task.step.duration
        )
        return found, slipped

    def _found(
        self,
        problem: SlidingProblem,
        start: FrictionStart,
        length: Vector,
        hold: LateralHold | None,
        bounds: NDArray[np.int8],
    ) -> TrackForces:
        high = friction.limits(self.laws, start) * length
        found = None
        if hold is not None:
            found = problem.sliding(hold, np.where(bounds[:-1] > 0, high, -high), bounds)
        return found or problem.bounded(-high, high, bounds)

    def _hold_of(self, table: ResponseTable, step: Step, depth: float, held: int) -> LateralHold:
        """Return what solves for the lateral forces, factorised where the tip will be deepest.

        A needle that turns changes all of it in every step.
        """
        axes, hold, varying = step.after.terms, self._hold, 0
        if not step.turning:
            if hold is not None and hold.serves(table, axes, held):
                return hold
            depth = min(held * self._spacing, self._length)
            varying = min(held - 1, int(self._bevel / self._spacing) + 1)
        arclength = self._places[:held] + (self._length - depth)
        softness = self._softness(depth, held)
        hold = LateralHold(table, axes, arclength, softness, self._rigidity, varying)
        if not step.turning:
            self._hold = hold
        return hold

    def _softness(self, depth: float, held: int) -> Vector:
        """Return how much softer the needle holds track points near its tip, m/N, (held,).

        The bevel thins the needle to nothing at the tip: there it holds the tissue
        sideways not at all, and wholly one bevel length behind. The density of the
        lateral force then has no peak at the tip that only the track spacing bounds.
        The entry is held by its edge.
        """
        soft, bevel, spacing = np.zeros(held), self._bevel, self._spacing
        last = held - 1
        behind = depth - last * spacing  # the tip is so far beyond a point
        while last > 0 and behind < bevel:
            soft[last] = (bevel / behind + behind / bevel - 2.0) / (self._grip * spacing)
            last, behind = last - 1, behind + spacing
        return soft
