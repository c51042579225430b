# SPDX-License-Identifier: Apache-2.0
"""The states of a recorded session, simulated again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from needle_sim_ros.session.replay import Tick, replay_ticks, steps

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.simulator import Simulator


def ticks_until(session: Session, tick: int) -> list[Tick]:
    """Return every tick since the simulation's start or last reset, up to a recorded one.

    Parameters
    ----------
    session : Session
        As read.
    tick : int
        Row of the session's series; the last tick is this one.

    Raises
    ------
    SessionError
        When the session does not say what was applied before it began.
    """
    end = round(float(session.series.time[tick]) * 1e9)
    until = [t for t in replay_ticks(session) if t.log_time is None or t.log_time <= end]
    start = max((k for k, t in enumerate(until) if t.reset), default=0)
    if start == 0:
        return until
    # Laws that were changed stay changed over a reset.
    earlier = tuple(change for t in until[:start] for change in t.changes)
    first = until[start]
    return [replace(first, changes=earlier + first.changes), *until[start + 1 :]]


def resimulate(
    session: Session, ticks: Sequence[Tick]
) -> Iterator[tuple[Tick, Simulator, Observation]]:
    """Simulate a session's scene through some of its ticks.

    Parameters
    ----------
    session : Session
        Gives scene and tick period.
    ticks : sequence of Tick
        From the start; see :func:`ticks_until`.

    Yields
    ------
    Tick, Simulator, Observation
        Each tick, the simulator in the state after it, and what can be seen there.

    Raises
    ------
    SessionError
        When the simulator refuses a tick.
    """
    from needle_sim_ros.simulator import Simulator

    sim = Simulator(session.scene())
    for tick, observation in steps(sim, ticks, float(session.metadata["tick_period"])):
        yield tick, sim, observation
