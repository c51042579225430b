# SPDX-License-Identifier: Apache-2.0
"""The state of a recorded session at one instant, simulated again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.motion import Motion

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.simulator import Simulator


def motions_until(session: Session, tick: int) -> list[Motion]:
    """Return the motion of every tick since the simulation's start, up to a recorded one.

    Parameters
    ----------
    session : Session
        As read.
    tick : int
        Row of the session's series; the last motion is that of this tick.

    Raises
    ------
    SessionError
        When the session does not say what was applied before it began.
    """
    end = round(float(session.series.time[tick]) * 1e9)
    resets = [t for t, event in session.events if event.get("event") == "reset" and t < end]
    if resets:
        return [motion for t, motion in session.motions if resets[-1] < t <= end]
    if session.before is None:
        raise SessionError(f"{session.path}: what was applied before the recording is not known")
    before = [motion for motion, count in session.before for _ in range(count)]
    return before + [motion for t, motion in session.motions if t <= end]


def resimulate(
    session: Session, motions: Sequence[Motion], advance: Callable[[], object] = lambda: None
) -> tuple[Simulator, Observation]:
    """Simulate a session's scene through motions of its ticks.

    Parameters
    ----------
    session : Session
        Gives scene and tick period.
    motions : sequence of Motion
        From the start; see :func:`motions_until`.
    advance : callable
        Called after each tick.

    Returns
    -------
    Simulator, Observation
        In the state after the last motion, and what can be seen there.
    """
    from needle_sim_ros.simulator import Simulator

    sim = Simulator(session.scene())
    period = float(session.metadata["tick_period"])
    for motion, same in groupby(motions):
        command = motion.command()
        for _ in same:
            sim.step(command, period)
            advance()
    return sim, sim.observe()
