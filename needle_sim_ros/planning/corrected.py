# SPDX-License-Identifier: Apache-2.0
"""Plans that hold in the full model: verify, and plan again with the bias that was found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.planning.planner import KEPT, Plan, Planner
from needle_sim_ros.planning.task import Task
from needle_sim_ros.planning.verify import FullModel, Verified, protocol_scene
from needle_sim_ros.scene import Scene

_MOST_CORRECTIONS = 4
# of the tolerance, up to what miss of the planning model its bias may be what is missing
_NEAR = 3.0
# by how much the full model may exceed a limit that the planning model keeps: what the two
# differ by at most
_ALLOWED = 0.01


@dataclass(frozen=True)
class VerifiedPlan:
    """A plan and how its protocol ends in the full model.

    Attributes
    ----------
    plan : Plan
    verified : Verified
    corrections : int
        How often it was planned again, with the bias found by then.
    reachable : bool
        Whether the full model meets the tolerance, the planning model the limits, and the
        full model its force and deflection within 1 %.
    """

    plan: Plan
    verified: Verified
    corrections: int
    reachable: bool


def plan_verified(
    planner: Planner,
    task: Task,
    plan: Plan,
    tick: Callable[[], object] = lambda: None,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> VerifiedPlan:
    """Run a plan in the full model; plan again while it misses there.

    Corrected plans run on the tissue that was prepared for the first, whose mesh is graded to
    a path a little beside theirs. One that hits is run once more on the mesh of its own path.

    Parameters
    ----------
    planner : Planner
    task : Task
    plan : Plan
        Of this planner, for this task.
    tick : callable
        Called after every rollout.
    progress : callable
        Called with (done, total) ticks of each run of the full model.

    Returns
    -------
    VerifiedPlan
        The best of all that were run in the full model.
    """
    runs = _Runs(planner, task, progress)
    here = best = runs.on_own_mesh(plan, 0)
    for corrections in range(1, _MOST_CORRECTIONS + 1):
        if here.reachable or not _near(plan, task):
            break
        # the outcome's gap holds the bias so far
        verified = here.verified
        bias = (verified.tip - verified.target) - (plan.outcome.gap - plan.bias)
        plan = planner.correct(plan, task, np.asarray(bias), tick)
        here = runs.on_kept_mesh(plan, corrections)
        if here.reachable:
            here = runs.on_own_mesh(plan, corrections)
        if _rank(here) < _rank(best):
            best = here
    return best if best is runs.latest_own else runs.on_own_mesh(best.plan, best.corrections)


class _Runs:
    """Runs of plans for one task in the full model."""

    def __init__(
        self, planner: Planner, task: Task, progress: Callable[[int, int], object]
    ) -> None:
        self._scene, self._task, self._progress = planner.scene, task, progress
        self._model: FullModel | None = None
        self.latest_own: VerifiedPlan | None = None

    def on_own_mesh(self, plan: Plan, corrections: int) -> VerifiedPlan:
        planned = protocol_scene(self._scene, plan.insertion, self._task.target)
        self._model = FullModel(planned)
        self.latest_own = self._judged(self._model, planned, plan, corrections)
        return self.latest_own

    def on_kept_mesh(self, plan: Plan, corrections: int) -> VerifiedPlan:
        assert self._model is not None
        planned = protocol_scene(self._scene, plan.insertion, self._task.target)
        return self._judged(self._model, planned, plan, corrections)

    def _judged(
        self, model: FullModel, planned: Scene, plan: Plan, corrections: int
    ) -> VerifiedPlan:
        verified = model.run(planned, self._progress)
        return VerifiedPlan(plan, verified, corrections, _reached(plan, verified, self._task))


def _near(plan: Plan, task: Task) -> bool:
    """Tell whether the planning model gets there, or so near that its bias may be the rest."""
    return plan.outcome.miss <= _NEAR * task.tolerance and not plan.outcome.stopped


def _reached(plan: Plan, verified: Verified, task: Task) -> bool:
    limits = task.limits
    return (
        verified.miss <= task.tolerance
        and plan.violations <= KEPT
        and not plan.outcome.stopped
        and verified.peak_force <= (1 + _ALLOWED) * limits.force
        and verified.deflection <= (1 + _ALLOWED) * limits.deflection
    )


def _rank(found: VerifiedPlan) -> tuple[bool, float, float]:
    return not found.reachable, found.plan.violations, found.verified.miss
