# SPDX-License-Identifier: Apache-2.0
"""The simulated stage, needle and tissue behind the node, without ROS.

One lock keeps ticks, resets and the start and end of recordings apart; commands come in
without it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import NeedleSimError, SessionError
from needle_sim_ros.ros.commands import Numbers, StageCommands
from needle_sim_ros.scene import Scene
from needle_sim_ros.session import cdr, channels
from needle_sim_ros.session.bag import new_folder
from needle_sim_ros.session.channels import Channel
from needle_sim_ros.session.history import History
from needle_sim_ros.session.motion import STILL, Motion
from needle_sim_ros.session.recorder import RecorderStatus
from needle_sim_ros.session.writer import SessionWriter, nanoseconds
from needle_sim_ros.simulator import Simulator

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation


@dataclass(frozen=True)
class Sink:
    """Where a topic's bytes go, and whether anybody wants them."""

    wanted: Callable[[], object]
    publish: Callable[[bytes], object]


@dataclass(frozen=True)
class Naming:
    """Frame ids, resolved topic names, and what else a session says about itself."""

    tissue_frame: str
    base_frame: str
    topics: Mapping[Channel, str] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)


class Plant:
    """Ticks the simulator by the stage's commands; publishes and records what comes out.

    Parameters
    ----------
    scene : Scene
        What to simulate.
    period : float
        dt of every tick, s.
    commands : StageCommands
        Where commands arrive.
    naming : Naming
        Frames and topic names.
    sinks : mapping of Channel to Sink
        Where messages are published; a topic without a sink is only recorded.
    warn : callable
        Told when the simulator refuses a command.
    """

    def __init__(
        self,
        scene: Scene,
        period: float,
        commands: StageCommands,
        naming: Naming,
        sinks: Mapping[Channel, Sink],
        warn: Callable[[str], object] = lambda message: None,
    ) -> None:
        self.scene = scene
        self.period = period
        self.commands = commands
        self.total_ticks = 0
        self.failed_ticks = 0
        self.last_failure = ""
        self.last_observation: Observation | None = None
        self.watch: Callable[[Observation, Motion], object] | None = None  # told of every tick
        self._naming = naming
        self._simulator = Simulator(scene)
        self._encoders = channels.output_encoders(naming.tissue_frame, naming.base_frame)
        self._motion_encoders = channels.motion_encoders(naming.tissue_frame)
        self._sinks = sinks
        self._warn = warn
        self._lock = threading.Lock()
        self._history = History()
        self._session: SessionWriter | None = None
        self._ended = RecorderStatus()
        self._epoch = 0  # what resets have to add to stamps, so that log time never goes back
        self._command: tuple[Motion, BaseCommand] = (STILL, STILL.command())
        self._begin()

    @property
    def ticks(self) -> int:
        """Ticks since the start or the last reset."""
        return self._history.ticks

    @property
    def waits(self) -> int:
        """Times that a tick waited for a solve of the tissue."""
        return self._simulator.statistics.waits

    @property
    def factorization(self) -> str:
        """The library that factorises the tissue's matrix, with its version."""
        return str(self._simulator.preparation.library)

    @property
    def stamp(self) -> int:
        """Simulated time, ns."""
        return nanoseconds(self.time)

    @property
    def recording(self) -> Path | None:
        """Folder of the session being recorded."""
        session = self._session
        return None if session is None else session.folder

    @property
    def recorder_status(self) -> RecorderStatus:
        """Where the recording stands, or how the last one ended."""
        session = self._session
        return self._ended if session is None else session.status

    @property
    def position(self) -> Numbers:
        """Where the base is, tissue frame, m."""
        return self._position

    def tick(self) -> None:
        """Advance by one period."""
        with self._lock:
            self._tick()

    def reset(self) -> None:
        """Go back to the scene's start; the command in force is forgotten."""
        with self._lock:
            self._simulator.reset()
            self._epoch += self.stamp
            self.commands.clear()
            self._history.clear()
            self._begin()
            self._event("reset")

    def start_recording(self, parent: Path) -> Path:
        """Begin a session in a new folder of `parent`; return the folder.

        Raises
        ------
        SessionError
            When one is being recorded already, or none can be.
        """
        with self._lock:
            if self._session is not None:
                raise SessionError(f"already recording in {self._session.folder}")
            self._epoch = 0  # resets before it are no business of this session's
            naming = self._naming
            self._session = SessionWriter(
                new_folder(parent, self.scene.name),
                self.scene,
                self.period,
                names=naming.topics,
                tissue_frame=naming.tissue_frame,
                base_frame=naming.base_frame,
                settings=naming.settings,
                history=self._history,
            )
            self._event("recording started")
            return self._session.folder

    def stop_recording(self, timeout: float = 5.0) -> tuple[Path, RecorderStatus]:
        """Finish the session; return its folder and how it ended.

        Raises
        ------
        SessionError
            When none is being recorded.
        """
        with self._lock:
            session = self._session
            if session is None:
                raise SessionError("not recording")
            self._event("recording stopped")
            self._session = None
        # Not under the lock: a slow disk must not hold up the ticks.
        self._ended = session.close(timeout)
        return session.folder, self._ended

    def record(self, channel: Channel, data: bytes) -> None:
        """Record a message at the present simulated time, if a session is being recorded."""
        session = self._session
        if session is not None:
            session.write(self._epoch + self.stamp, [(channel, data)])

    def event(self, event: str, **details: object) -> None:
        """Record that something happened."""
        with self._lock:
            self._event(event, **details)

    def _event(self, event: str, **details: object) -> None:
        details = {"time": self.time, "ticks": self.ticks, **details}
        self._emit([(channels.EVENTS, lambda: channels.event_message(event, **details))])

    def _emit(self, messages: Iterable[tuple[Channel, Callable[[], bytes]]]) -> None:
        """Publish what is wanted and record everything; nothing is made in vain."""
        session, recorded = self._session, []
        for channel, encode in messages:
            sink = self._sinks.get(channel)
            wanted = sink is not None and sink.wanted()
            if wanted or session is not None:
                data = encode()
                recorded.append((channel, data))
                if sink is not None and wanted:
                    sink.publish(data)
        if session is not None:
            session.write(self._epoch + self.stamp, recorded)

    def _begin(self) -> None:
        base = self.scene.base
        self.last_observation = None
        self.time = 0.0
        self._position: Numbers = tuple(base.position or ())
        self._orientation: Numbers = tuple(base.orientation)

    def _tick(self) -> None:
        stepped = self._step()
        if stepped is None:
            return
        observation, motion = stepped
        self._history.add(motion)
        self.total_ticks += 1
        if self.watch is not None:
            self.watch(observation, motion)
        self.last_observation = observation
        self.time = observation.time
        self._position = observation.base_position.tolist()
        self._orientation = observation.base_orientation.tolist()
        stamp = self.stamp
        clock = self._sinks.get(channels.CLOCK)
        if clock is not None:
            clock.publish(cdr.clock(stamp))
        applied, encode_motion = self._motion_encoders[motion.kind]
        messages: list[tuple[Channel, Callable[[], bytes]]] = [
            (channel, partial(encode, stamp, observation))
            for channel, encode in self._encoders.items()
        ]
        messages.append((applied, partial(encode_motion, stamp, motion)))
        self._emit(messages)

    def _step(self) -> tuple[Observation, Motion] | None:
        """Step by the command in force, or stand still where the simulator refuses it."""
        motion = self.commands.motion(self._position, self._orientation, self.time, self.period)
        try:
            return self._simulator.step(self._command_of(motion), self.period), motion
        except NeedleSimError as error:
            self.commands.refuse_current(type(error).__name__)
            self._event("command refused", reason=str(error))
            self._warn(f"command refused: {error}")
        try:
            return self._simulator.step(self._command_of(STILL), self.period), STILL
        except NeedleSimError as error:
            self.failed_ticks += 1
            self.last_failure = str(error)
            return None

    def _command_of(self, motion: Motion) -> BaseCommand:
        if motion is not self._command[0]:
            self._command = motion, motion.command()
        return self._command[1]
