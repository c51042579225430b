# SPDX-License-Identifier: Apache-2.0
"""How the node stands load, hostility and sudden ends over minutes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needle_sim_ros.benchmark.result import BenchmarkResult
from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.scene import Scene

    Drive = Callable[["Scene", "Plan", Callable[[float], object]], dict[str, float | None]]

RATE = 1000.0  # Hz
_STEPS = 1000  # of the progress
_LIMITS = {
    "overrun_fraction": 1e-3,
    "lost_messages": 0,
    "missing_ticks_recorded": None,
    "rss_growth_mb": 5.0,
    "latency_median_ticks": 2.0,
    "latency_p99_ticks": 4.0,
    "state_changes_by_hostile_messages": 0,
    "kill9_worst_loss_s": 0.5,
    "sigterm_worst_s": 2.0,
}


@dataclass(frozen=True)
class Plan:
    """How long and how often.

    Parameters
    ----------
    steady : float
        At the rate with recording and two subscribers, s.
    crowd : float
        With ten subscribers and hostile publishers, s.
    cycles : int
        Starts and stops of the recording meanwhile.
    hostile : int
        Hostile messages between steps.
    endings : int
        Nodes to kill, and as many to tell to end.
    rate : float
        Ticks per second, Hz.
    dedicated_core : int
    keep_awake : bool
        As the node's parameters, while it is under load.
    """

    steady: float
    crowd: float
    cycles: int
    hostile: int
    endings: int
    rate: float = RATE
    dedicated_core: int = -1
    keep_awake: bool = False

    @property
    def hostile_seconds(self) -> float:
        """About how long the hostile messages take, s."""
        return 1e-3 * self.hostile

    @property
    def ending_seconds(self) -> float:
        """About how long a node takes to start and end, s."""
        return 5.0

    @property
    def seconds(self) -> float:
        """About how long everything takes, s."""
        return (
            self.steady
            + self.crowd
            + 20.0
            + self.hostile_seconds
            + 2 * self.endings * self.ending_seconds
        )


def plan(
    minutes: float | None, quick: bool, dedicated_core: int = -1, keep_awake: bool = False
) -> Plan:
    """Return what to do: `minutes` of load, by default 10, or a third of one when quick."""
    steady = 60.0 * (minutes if minutes is not None else 0.35 if quick else 10.0)
    crowd, cycles, hostile, endings = (10.0, 5, 1000, 2) if quick else (120.0, 100, 100_000, 50)
    return Plan(
        steady,
        min(steady, crowd),
        cycles,
        hostile,
        endings,
        dedicated_core=dedicated_core,
        keep_awake=keep_awake,
    )


def soak(
    scene: Scene,
    quick: bool = False,
    progress: Callable[[int, int], object] = lambda done, total: None,
    minutes: float | None = None,
    dedicated_core: int = -1,
    keep_awake: bool = False,
    node: Drive | None = None,
) -> BenchmarkResult:
    """Soak the node; its tick is made the period of the rate.

    Parameters
    ----------
    scene : Scene
        `solver.time_step` is set to the tick.
    quick : bool
        Fewer of everything.
    progress : callable
        Called with (done, total).
    minutes : float, optional
        Of steady load.
    dedicated_core : int
        Processor that the node's clock loop has to itself under load; -1: none.
    keep_awake : bool
        Whether the node under load keeps the processors awake.
    node : callable
        Drives the node; in the package `needle_sim_ros.ros.soak.drive.drive`.

    Raises
    ------
    NeedleSimError
        When ROS is not installed, or the node ends.
    """
    if node is None:
        raise NeedleSimError("benchmark soak drives the node: it needs ROS 2 (rclpy)")
    todo = plan(minutes, quick, dedicated_core, keep_awake)
    scene = scene.with_changes({"solver.time_step": 1.0 / todo.rate})
    done = 0.0

    def advance(share: float) -> None:
        nonlocal done
        done = min(1.0, done + share)
        progress(int(_STEPS * done), _STEPS)

    figures = node(scene, todo, advance)
    progress(_STEPS, _STEPS)
    table = [
        {"figure": name, "measured": figures[name], "limit": limit}
        for name, limit in _LIMITS.items()
    ]
    return BenchmarkResult("soak", scene.name, figures, table)
