# SPDX-License-Identifier: Apache-2.0
"""A recorded session simulated again from what every tick applied."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from needle_sim_ros.errors import NeedleSimError, SessionError
from needle_sim_ros.session import channels
from needle_sim_ros.session.collect import Collector
from needle_sim_ros.session.encoding import output_encoders
from needle_sim_ros.session.motion import STILL, Motion
from needle_sim_ros.session.reader import Recorded
from needle_sim_ros.session.writer import nanoseconds

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.session.reader import Session
    from needle_sim_ros.session.series import Series
    from needle_sim_ros.simulator import Simulator


@dataclass(frozen=True)
class Tick:
    """One tick of a replay.

    Parameters
    ----------
    motion : Motion
        What it applies.
    log_time : int or None
        Where it stands in the recording, ns; None before the recording began.
    reset : bool
        Whether the simulation went back to its start before it.
    held : bool
        Whether its own command is lost, and it goes on as the tick before.
    changes : tuple of mapping
        How the interaction laws change before it, in this order, and after a reset.
    """

    motion: Motion
    log_time: int | None
    reset: bool = False
    held: bool = False
    changes: tuple[Mapping[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Replay:
    """What a replay gave.

    Parameters
    ----------
    series : Series
        Every output, as a recording of it would be read.
    ticks, held : int
        Ticks simulated, and those of them whose command was lost.
    messages : mapping
        Log times and serialised messages of every output, by role; empty when they were not
        asked for.
    """

    series: Series
    ticks: int
    held: int
    messages: Recorded


def replay_ticks(session: Session) -> list[Tick]:
    """Return all ticks since the simulation's start.

    Commands that are lost, which the log times tell, are held as the tick before.

    Raises
    ------
    SessionError
        When nothing was applied, or what was applied before is not known.
    """
    path = session.path
    if not session.motions:
        raise SessionError(f"{path}: no command topic: no tick's applied motion was recorded")
    period = float(session.metadata["tick_period"]) * 1e9
    resets = [time for time, event in session.events if event.get("event") == "reset"]
    motions, ticks = session.motions, []
    if session.before is None:
        motions = [entry for entry in motions if resets and entry[0] > resets[0]]
        if not motions:
            raise SessionError(f"{path}: what was applied before the recording is not known")
        last, now = resets[0], STILL
    else:
        ticks = [Tick(motion, None) for motion, count in session.before for _ in range(count)]
        last, now = round(len(ticks) * period), ticks[-1].motion if ticks else STILL
    waiting = [time for time in resets if time >= last]
    for time, motion in motions:
        fresh = bool(waiting) and time > waiting[0]
        while waiting and time > waiting[0]:
            last, now = waiting.pop(0), STILL
        missing = max(0, round((time - last) / period) - 1)
        for k in range(missing):
            at = last + round((k + 1) * period)
            ticks.append(Tick(now, at, reset=fresh and k == 0, held=True))
        ticks.append(Tick(motion, time, reset=fresh and not missing))
        last, now = time, motion
    return _with_changes(session, ticks)


def _with_changes(session: Session, ticks: list[Tick]) -> list[Tick]:
    """Return the ticks with the changes of the laws that came before them."""
    recorded = [
        (time, event["changes"])
        for time, event in session.events
        if event.get("event") == channels.INTERACTION_EVENT
    ]
    if not (recorded or session.changes_before):
        return ticks
    earlier = list(session.changes_before)
    if session.before is None:  # the ticks they belong to are not known, but all are earlier
        earlier = [(0, values) for _, values in earlier]
    changed = []
    for number, tick in enumerate(ticks):
        due: list[Mapping[str, float]] = []
        while earlier and earlier[0][0] <= number:
            due.append(earlier.pop(0)[1])
        while recorded and tick.log_time is not None and recorded[0][0] < tick.log_time:
            due.append(recorded.pop(0)[1])
        changed.append(replace(tick, changes=tuple(due)) if due else tick)
    return changed


def replay(
    about: Mapping[str, str],
    simulator: Simulator,
    ticks: list[Tick],
    advance: Callable[[], object] = lambda: None,
    messages: bool = False,
) -> Replay:
    """Step a simulator through the ticks of a session.

    Parameters
    ----------
    about : mapping
        The session's metadata: tick period and frames.
    simulator : Simulator
        At its start.
    ticks : list of Tick
        See :func:`replay_ticks`.
    advance : callable
        Called after each tick.
    messages : bool
        Whether to serialise the outputs too, for another recording.

    Raises
    ------
    SessionError
        When the simulator refuses a tick, with its time.
    """
    encoders = output_encoders(about["tissue_frame"], about["base_frame"])
    written = channels.OUTPUTS if messages else ()
    outputs: dict[str, tuple[list[int], list[bytes]]] = {c.role: ([], []) for c in written}
    collector = Collector(len(ticks), len(simulator.scene.markers))
    for tick, observation in steps(simulator, ticks, float(about["tick_period"])):
        advance()
        if tick.log_time is None:
            continue
        collector.add(tick.log_time, observation)
        if not messages:
            continue
        made = encoders.together(nanoseconds(observation.time), observation)
        for (times, rows), data in zip(outputs.values(), made, strict=True):
            times.append(tick.log_time)
            rows.append(data)
    held = sum(tick.held for tick in ticks)
    series = collector.series(simulator.scene.to_yaml(), about)
    return Replay(series, len(ticks), held, outputs)


def steps(
    simulator: Simulator, ticks: Sequence[Tick], period: float
) -> Iterator[tuple[Tick, Observation]]:
    """Step a simulator at its start through ticks; yield each with what is seen after it.

    Raises
    ------
    SessionError
        When the simulator refuses a tick, with its time.
    """
    motion = STILL
    for tick in ticks:
        if tick.reset:
            simulator.reset()
        for changes in tick.changes:
            simulator.change_interaction(changes)
        if tick.motion != motion:
            motion = tick.motion
        try:
            observation = simulator.step(motion.command(), period)
        except NeedleSimError as error:
            when = (
                "before the recording" if tick.log_time is None else f"{tick.log_time * 1e-9:g} s"
            )
            raise SessionError(f"the replay ends at {when}: {error}") from error
        yield tick, observation
