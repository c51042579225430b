# SPDX-License-Identifier: Apache-2.0
"""Plans that hold in the full model: verify, and plan again with the bias that was found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.planning.planner import KEPT, Plan, Planner
from needle_sim_ros.planning.task import Task
from needle_sim_ros.planning.verify import Verified, protocol_scene, verify

_MOST_CORRECTIONS = 2
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
    best: VerifiedPlan | None = None
    for corrections in range(_MOST_CORRECTIONS + 1):
        planned = protocol_scene(planner.scene, plan.insertion, task.target)
        verified = verify(planned, progress)
        here = VerifiedPlan(plan, verified, corrections, _reached(plan, verified, task))
        if best is None or _rank(here) < _rank(best):
            best = here
        if here.reachable or corrections == _MOST_CORRECTIONS or not _met(plan, task):
            break
        # the outcome's gap holds the bias so far
        bias = (verified.tip - verified.target) - (plan.outcome.gap - plan.bias)
        plan = planner.correct(plan, task, np.asarray(bias), tick)
    assert best is not None
    return best


def _met(plan: Plan, task: Task) -> bool:
    """Tell whether the planning model gets there; if not, its bias is not what is wrong."""
    return plan.reachable and plan.outcome.miss <= task.tolerance


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
