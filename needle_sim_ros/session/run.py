# SPDX-License-Identifier: Apache-2.0
"""Drive a simulator through commands, in process, tick by tick."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.session.series import Array, Series

if TYPE_CHECKING:
    from needle_sim_ros.command import BaseCommand
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.simulator import Simulator

    Watcher = Callable[[BaseCommand, Observation], object]


@dataclass(frozen=True, eq=False)
class Run:
    """What a run gave and what it took.

    Parameters
    ----------
    series : Series
        One row per tick.
    tick_times : (n,) array
        Wall-clock time of each call of ``Simulator.step``, s.
    wall_time : float
        Of the whole loop, with what the watchers did, s.
    overruns : int
        Ticks that ended late when running in real time; else 0.
    """

    series: Series
    tick_times: Array
    wall_time: float
    overruns: int


def run(
    sim: Simulator,
    commands: Sequence[BaseCommand],
    time_step: float,
    *,
    realtime: bool = False,
    watchers: Sequence[Watcher] = (),
) -> Run:
    """Step through the commands and collect every observation.

    Parameters
    ----------
    sim : Simulator
        In the state to start from.
    commands : sequence of BaseCommand
        One per tick.
    time_step : float
        Tick, s.
    realtime : bool
        Wait for the wall clock before each tick. A late tick is counted and not made
        up for.
    watchers : sequence of callables
        Called with each tick's command and observation: recorders, progress bars.
    """
    tick_times = np.zeros(len(commands))
    late = 0

    def observations() -> Iterator[Observation]:
        nonlocal late
        due = time.perf_counter()
        for i, command in enumerate(commands):
            start = time.perf_counter()
            observation = sim.step(command, time_step)
            tick_times[i] = time.perf_counter() - start
            yield observation
            for watcher in watchers:
                watcher(command, observation)
            if realtime:
                due += time_step
                left = due - time.perf_counter()
                if left > 0:
                    time.sleep(left)
                else:
                    late += 1
                    due -= left

    begin = time.perf_counter()
    series = Series.from_observations(observations(), sim.scene)
    return Run(series, tick_times, time.perf_counter() - begin, late)


class InsertionEnd:
    """A watcher that keeps the state at the end of the deepest insertion.

    Parameters
    ----------
    sim : Simulator
        That runs; its snapshots cost nothing.
    """

    def __init__(self, sim: Simulator) -> None:
        self._sim = sim
        self._depth = 0.0
        self.snapshot = sim.snapshot()

    def __call__(self, command: BaseCommand, observation: Observation) -> None:
        """Look at one tick."""
        inserting = observation.process.value == "insertion"
        if inserting and observation.insertion_depth >= self._depth:
            self._depth = observation.insertion_depth
            self.snapshot = self._sim.snapshot()


def insertion_end(series: Series) -> int:
    """Return the tick at the end of the deepest insertion; without one, the last tick."""
    inserting = np.array(series.process) == "insertion"
    if not inserting.any():
        return len(series) - 1
    depth = np.where(inserting, series.insertion_depth, -np.inf)
    return len(depth) - 1 - int(np.argmax(depth[::-1]))
