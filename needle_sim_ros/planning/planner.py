# SPDX-License-Identifier: Apache-2.0
"""Find the insertion whose tip reaches a target that moves with the tissue."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import least_squares

from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.planning.aim import plain_aim
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.quick import MaterialPoint, QuickSimulator, planning_scene
from needle_sim_ros.planning.rollout import Outcome, roll_out
from needle_sim_ros.planning.secant import SecantJacobian
from needle_sim_ros.planning.task import Task, check
from needle_sim_ros.planning.variables import Variables
from needle_sim_ros.scene import Scene

# of the tolerance, at what miss the search is content, by dimension
_CONTENT = {2: 0.2, 3: 0.5}
# up to what part a limit counts as kept: the search ends on its border
KEPT = 1e-5
_MOST_ROLLOUTS = 30  # from each start
_MOST_IN_ALL = 90  # before another start is tried
_MOST_AGAIN = 8  # from a plan, once the model's bias is known
# rollouts on the analytic guess of arcs, and what part of the miss each has to leave at most
_MOST_ARCS, _STALLED = 8, 0.9
_REACH = 4e-3  # m, half width of the fine mesh about the plain aim
_CORE = 2e-3  # m, radius at the surface of what is prepared for bevels that turn
_SCALE = 1e-3  # m, a miss of this counts as one


@dataclass(frozen=True)
class Plan:
    """What was found.

    Attributes
    ----------
    insertion : Insertion
    outcome : Outcome
        Of the insertion, in the planning model.
    plain : Outcome
        Of the plain aim: straight at the undisplaced target.
    reachable : bool
        Whether miss and limits are met; else it is the nearest that was found.
    violations : float
        Largest part by which a limit is exceeded.
    rollouts : int
    bias : ndarray, shape (3,)
        How much farther from the target the tip was taken to end than the planning model
        has it, m; part of the outcome's miss.
    """

    insertion: Insertion
    outcome: Outcome
    plain: Outcome
    reachable: bool
    violations: float
    rollouts: int
    bias: Vector = field(default_factory=lambda: np.zeros(3))

    def aimed_at(self, target: Sequence[float]) -> Vector:
        """Return the place (3,) that stands for a target in the planning model, m."""
        return np.asarray(target) - self.bias


class _Found(Exception):
    """The search is content."""


class Planner:
    """Plans insertions of a scene.

    Parameters
    ----------
    scene : Scene
    aim : Insertion, optional
        About whose path the mesh is fine; by default the one that the scene plans.
    reach : float, optional
        How far about it candidate paths may lie, m.
    progress : callable, optional
        Called with (done, total) while the tissue is prepared.
    """

    def __init__(
        self,
        scene: Scene,
        aim: Insertion | None = None,
        reach: float | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self.scene = scene
        about = scene if aim is None else aim.scene_of(scene)
        self.reach = _REACH if reach is None else reach
        self.simulator = QuickSimulator(planning_scene(about, self.reach), progress)

    @classmethod
    def towards(
        cls, scene: Scene, task: Task, progress: Callable[[int, int], None] | None = None
    ) -> Planner:
        """Return a planner whose mesh is fine about the plain aim at a target."""
        check(task, scene)
        aim = plain_aim(scene, task)
        if "roll" in task.vary or "schedule" in task.vary:
            return cls.all_round(scene, aim, progress)
        return cls(scene, aim, None, progress)

    @classmethod
    def all_round(
        cls, scene: Scene, aim: Insertion, progress: Callable[[int, int], None] | None = None
    ) -> Planner:
        """Return a planner for bevels that steer from an aim to any side."""
        slope = math.tan(abs(scene.needle.tip.deviation_angle))
        planner = cls(scene, aim, max(_REACH, slope * aim.travel), progress)
        planner.simulator.prepare_cone(_CORE, slope)
        return planner

    def plan(self, task: Task, tick: Callable[[], object] = lambda: None) -> Plan:
        """Find an insertion.

        Parameters
        ----------
        task : Task
        tick : callable
            Called after every rollout.

        Raises
        ------
        NeedleSimError
            When the task is inadmissible.
        """
        check(task, self.scene)
        return _Search(self.simulator, self.scene, task, self.reach, tick).run()

    def correct(
        self, plan: Plan, task: Task, bias: Vector, tick: Callable[[], object] = lambda: None
    ) -> Plan:
        """Plan again, from a plan on, with a known bias of this model.

        Parameters
        ----------
        plan : Plan
            Of this planner, for the same task.
        task : Task
        bias : ndarray, shape (3,)
            How much farther from the target the tip ends than this model has it, m.
        tick : callable
            Called after every rollout.
        """
        search = _Search(self.simulator, self.scene, task, self.reach, tick, bias)
        return search.run_from(plan)


class _Search:
    """The search for one target."""

    def __init__(
        self,
        simulator: QuickSimulator,
        scene: Scene,
        task: Task,
        reach: float,
        tick: Callable[[], object],
        bias: Vector | None = None,
    ) -> None:
        self._simulator, self._task, self._tick = simulator, task, tick
        self._bias = np.zeros(3) if bias is None else np.asarray(bias, dtype=float)
        self._scene = scene
        self._radius = scene.needle.radius
        self._aim = plain_aim(scene, task)
        there = simulator.material_point(task.target)
        # a tip seen farther by the bias is one seen from a target moved back by it
        self._point = MaterialPoint(there.place - self._bias, there.response)
        self._variables = Variables.of(task.vary, scene, self._aim, reach)
        self._best: tuple[float, float, Insertion, Outcome] | None = None
        self._rollouts = 0

    def run(self) -> Plan:
        plain = roll_out(self._simulator, self._aim, self._point)
        self._rollouts += 1
        try:
            if {"roll", "schedule"} <= set(self._task.vary):
                self._by_arcs(plain)
                if self._met():
                    return self._plan(plain)
            for start in self._variables.starts(self._guess(plain)):
                self._from(start)
                if self._met() or self._rollouts >= _MOST_IN_ALL:
                    break
        except _Found:
            pass
        return self._plan(plain)

    def run_from(self, plan: Plan) -> Plan:
        self._rollouts = plan.rollouts
        with suppress(_Found):
            if {"roll", "schedule"} <= set(self._task.vary):
                self._by_arcs(plan.plain)
            if not self._met():
                self._from(self._variables.of_insertion(self._aim, plan.insertion), _MOST_AGAIN)
        return self._plan(plan.plain)

    def _plan(self, plain: Outcome) -> Plan:
        assert self._best is not None
        worst, _, insertion, outcome = self._best
        return Plan(
            insertion.with_travel(outcome.travel),
            outcome,
            plain,
            self._met(),
            worst,
            self._rollouts,
            self._bias,
        )

    def _by_arcs(self, plain: Outcome) -> None:
        """Search with a bevel turned round once, as if it steered along circles.

        What a rollout ends beside the circles is taken off the next one's aim: that
        contracts by how wrong the circles are, and costs one rollout each time.
        """
        steered, base = self._sideways(plain)
        least, step, part = math.inf, 0j, 1.0
        for _ in range(_MOST_ARCS):
            outcome = self._tried(self._arcs(steered, base - part * step))
            if outcome.miss < _STALLED * least:
                base -= part * step
                least, step, part = outcome.miss, complex(*(self._axes() @ outcome.gap)), 1.0
            else:  # the end leaps where the turn passes the middle of a segment
                part *= 0.5

    def _axes(self) -> Vector:
        return np.asarray(rotation_matrix(self._aim.orientation)[:, :2].T)

    def _sideways(self, plain: Outcome) -> tuple[complex, complex]:
        """Return how far the plain aim steered and should have, x + i y of the base, m."""
        straight = np.array([*self._aim.entry, 0.0]) + self._aim.travel * self._aim.axis
        axes = self._axes()
        target = plain.target - self._bias
        return complex(*(axes @ (plain.tip - straight))), complex(*(axes @ (target - straight)))

    def _arcs(self, steered: complex, wanted: complex) -> Insertion:
        """Return the insertion whose bevel is turned round once, on circles.

        A bevel that steers along a circle deflects the tip by a share 1 - 2 (1 - a)^2 of
        what it can when it is turned round after the part a of the way.
        """
        most = max(abs(steered), 1e-9)
        part = 1 - math.sqrt((1 - min(abs(wanted) / most, 1.0)) / 2)
        roll = cmath.phase(wanted / steered) if steered else 0.0
        stop = min(max(part, 0.1), 1.0) * self._aim.travel
        return replace(self._aim, roll=roll, turn=math.pi, turn_at=stop)

    def _guess(self, plain: Outcome) -> dict[str, float]:
        """Guess how the bevel has to stand, from how the plain aim was deflected."""
        if self._scene.dimension == 2:
            return {}
        arcs = self._arcs(*self._sideways(plain))
        stop = min(max(arcs.turn_at, 0.15 * self._aim.travel), 0.85 * self._aim.travel)
        return {"roll": arcs.roll, "turn": math.pi, "turn_at": stop - self._aim.turn_at}

    def _met(self) -> bool:
        if self._best is None:
            return False
        worst, miss, _, outcome = self._best
        return worst <= KEPT and miss <= self._task.tolerance and not outcome.stopped

    def _from(self, start: Vector, most: int = _MOST_ROLLOUTS) -> None:
        low, high = self._variables.bounds()
        jacobian = SecantJacobian(self._residuals, self._variables.steps())
        least_squares(
            jacobian.function,
            np.clip(start, low, high),
            jac=jacobian,
            bounds=(low, high),
            xtol=1e-5,
            ftol=1e-6,
            gtol=1e-9,
            max_nfev=most,
        )

    def _residuals(self, x: Vector) -> Vector:
        outcome = self._tried(self._variables.apply(self._aim, x))
        over = self._task.limits.violations(outcome, self._radius)
        return np.concatenate([outcome.gap / _SCALE, 3.0 * np.array(over)])

    def _tried(self, insertion: Insertion) -> Outcome:
        """Roll an insertion out and keep it when it is the best.

        Raises
        ------
        _Found
            When it is good enough.
        """
        outcome = roll_out(self._simulator, insertion, self._point, arrive=True)
        self._rollouts += 1
        self._tick()
        over = self._task.limits.violations(outcome, self._radius)
        worst, miss = max(over, default=0.0), outcome.miss
        if outcome.stopped:
            worst = max(worst, 1.0)
        if self._best is None or _badness(worst, miss) < _badness(*self._best[:2]):
            self._best = (worst, miss, insertion, outcome)
        if worst <= KEPT and miss <= _CONTENT[self._scene.dimension] * self._task.tolerance:
            raise _Found
        return outcome


def _badness(worst: float, miss: float) -> float:
    return miss + (3.0 * worst * _SCALE if worst > KEPT else 0.0)
