# SPDX-License-Identifier: Apache-2.0
"""Rollouts side by side on any executor: each process prepares a scene's tissue once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.quick import QuickSimulator
from needle_sim_ros.planning.rollout import Outcome, roll_out
from needle_sim_ros.scene import Scene

_KEPT: dict[Scene, QuickSimulator] = {}
_MOST_KEPT = 2


@dataclass(frozen=True)
class Trial:
    """An insertion to be rolled out, and what is different from the scene in it.

    Attributes
    ----------
    insertion : Insertion
    target : tuple of 3 floats, optional
        Reference position, m.
    changes : mapping
        As :meth:`QuickSimulator.variant` takes them.
    arrive : bool
        End at the level of the target.
    """

    insertion: Insertion
    target: tuple[float, ...] | None = None
    changes: Mapping[str, object] = field(default_factory=dict)
    arrive: bool = False


def kept_simulator(scene: Scene) -> QuickSimulator:
    """Return this process's simulator of a planning scene, prepared at the first call."""
    if scene not in _KEPT:
        while len(_KEPT) >= _MOST_KEPT:
            _KEPT.pop(next(iter(_KEPT)))
        _KEPT[scene] = QuickSimulator(scene)
    return _KEPT[scene]


def keep(simulator: QuickSimulator) -> None:
    """Let tasks of this process use a simulator that is there already."""
    _KEPT[simulator.scene] = simulator


def run_trials(scene: Scene, trials: Sequence[Trial]) -> list[Outcome]:
    """Roll trials out one after the other in this process.

    A trial whose changes do not make a scene gives an outcome that says so.
    """
    simulator, outcomes = kept_simulator(scene), []
    points = {}
    for trial in trials:
        if trial.target is not None and trial.target not in points:
            points[trial.target] = simulator.material_point(trial.target)
        point = None if trial.target is None else points[trial.target]
        try:
            own = simulator.changed(trial.changes) if trial.changes else simulator
            outcome = roll_out(own, trial.insertion, point, trial.arrive)
        except NeedleSimError as error:
            outcome = _failed(simulator, str(error))
        outcomes.append(outcome)
    return outcomes


def _failed(simulator: QuickSimulator, reason: str) -> Outcome:
    nowhere: Vector = simulator.reset().tip_position * float("nan")
    return Outcome(0.0, nowhere, nowhere, 0.0, 0.0, nowhere[None, :], 0, reason)


def side_by_side(
    scene: Scene, trials: Sequence[Trial], executor: Executor, together: int = 8
) -> Iterator[Outcome]:
    """Roll trials out on an executor; yield their outcomes in order.

    Parameters
    ----------
    scene : Scene
        A planning scene.
    trials : sequence of Trial
    executor : concurrent.futures.Executor
    together : int
        Trials in a task.
    """
    parts = [trials[i : i + together] for i in range(0, len(trials), together)]
    for outcomes in [executor.submit(run_trials, scene, part) for part in parts]:
        yield from outcomes.result()
