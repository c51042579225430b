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


def deepest_tick(series: Series) -> int:
    """Return the first tick at the greatest insertion depth, but for a nanometre.

    In a protocol that goes in, holds and comes out: the end of the insertion.
    """
    depth = series.insertion_depth
    return int(np.argmax(depth >= depth.max() - 1e-9))
