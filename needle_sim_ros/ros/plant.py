# SPDX-License-Identifier: Apache-2.0
"""The simulated stage, needle and tissue behind the node, without ROS.

One lock keeps ticks, resets and the start and end of recordings apart, another one resets
and recordings in the making; commands come in without them.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.commands import Numbers, StageCommands
from needle_sim_ros.ros.outlet import Naming, Outlet, Sink
from needle_sim_ros.scene import Scene
from needle_sim_ros.session import cdr, channels, encoding
from needle_sim_ros.session.bag import NO_SPLIT, Split
from needle_sim_ros.session.channels import Channel
from needle_sim_ros.session.history import History
from needle_sim_ros.session.motion import STILL, Motion
from needle_sim_ros.session.recorder import RecorderStatus
from needle_sim_ros.session.writer import nanoseconds
from needle_sim_ros.simulator import Simulator

if TYPE_CHECKING:
    from needle_sim_ros.geometry import Vector
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.statistics import Statistics

_PATIENCE = 5e-3  # s that others wait for a tick: commands must not pile up behind slow ones
_AWAKE = 1e-4  # s, within which a tick that is due has begun: who wakes with it may be faster
ROOM = 1e-4  # s, in which whoever works beside the ticks does a piece of it


class Plant:
    """Ticks the simulator by the stage's commands; publishes and records what comes out.

    Parameters
    ----------
    scene : Scene
        What to simulate. The attribute is the scene that the ticks since the last reset
        started with.
    period : float
        dt of every tick, s.
    commands : StageCommands
        Where commands arrive.
    naming : Naming
        Frames and topic names.
    sinks : mapping of Channel to Sink
        Where messages are published.
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
        self.time_left: Callable[[], float] = lambda: math.inf  # until the next tick begins, s
        self.greet: Callable[[], object] = lambda: None  # each thread that gives way, once
        self._known = threading.local()
        self._simulator = Simulator(scene)
        self._simulator.prepare_beside()
        self._encoders = encoding.output_encoders(naming.tissue_frame, naming.base_frame)
        self._motion_encoders = encoding.motion_encoders(naming.tissue_frame)
        self._outlet = Outlet(naming, sinks, partial(self.give_way, ROOM))
        self._warn = warn
        self._lock = threading.Lock()
        self._setting = threading.Lock()  # for what keeps a scene through more than one tick
        self._history = History()
        self._history.reserve()
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
    def prepared_beside(self) -> float:
        """What part of the tissue about the planned path is prepared, 0 to 1."""
        return self._simulator.prepared_beside

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
        return self._outlet.folder

    @property
    def recorder_status(self) -> RecorderStatus:
        """Where the recording stands, or how the last one ended."""
        return self._outlet.status

    @property
    def statistics(self) -> Statistics:
        """What the simulator counts: solves, waits for them, iterations."""
        return self._simulator.statistics

    @property
    def current_scene(self) -> Scene:
        """The scene with the interaction laws of now."""
        return self._simulator.scene

    @property
    def position(self) -> Numbers:
        """Where the base is, tissue frame, m."""
        return self._position

    def tissue_displacement(self, points: Vector, seen: Observation) -> Vector:
        """Return displacements at an instant seen before, (n, 3), m; may run beside a tick."""
        return self._simulator.tissue_displacement(points, seen)

    def tick(self) -> None:
        """Advance by one period."""
        with self._lock:
            self._tick()

    def give_way(self, room: float = 0.0) -> None:
        """Wait until a tick under way is over, but not long: for whoever works beside the ticks.

        A tick lets go of the interpreter lock now and then, in the linear algebra. Who takes
        it keeps the tick waiting for longer than the tick itself takes.

        Parameters
        ----------
        room : float
            Time to work for, s: where the next tick begins sooner, that one is waited for.
        """
        if not hasattr(self._known, "greeted"):
            self._known.greeted = True
            self.greet()
        left = self.time_left()
        if 0 < left < room:
            time.sleep(left + _AWAKE)
        if self._lock.acquire(timeout=_PATIENCE):
            self._lock.release()

    def reset(self) -> None:
        """Go back to the scene's start; the command in force is forgotten."""
        with self._setting, self._lock:
            self._simulator.reset()
            self._outlet.epoch += self.stamp
            self.commands.clear()
            self._history.clear()
            self._history.reserve()
            self.scene = self._simulator.scene  # laws that were changed stay changed
            self._begin()
            self._event("reset")

    def change_interaction(self, changes: Mapping[str, float]) -> None:
        """Change interaction laws before the next tick, by keys below `interaction`.

        Raises
        ------
        SceneError
            When the scene would not allow it; nothing is changed then.
        """
        # Outside the lock: making and checking a scene takes longer than a tick.
        scene = changed_scene(self._simulator.scene, changes)
        with self._lock:
            self._simulator.take_interaction(scene)
            self._history.change(changes)
            self._event(channels.INTERACTION_EVENT, changes=dict(changes))

    def start_recording(self, parent: Path, split: Split = NO_SPLIT) -> Path:
        """Begin a session in a new folder of `parent`; return the folder.

        Raises
        ------
        SessionError
            When one is being recorded already, or none can be.
        """
        # Not under the ticks' lock: to make the file takes longer than some ticks.
        with self._setting:
            session = self._outlet.prepare(parent, self.scene, self.period, split)
            with self._lock:
                self._outlet.attach(session, self._history.copy())
                self._event("recording started")
        return session.folder

    def stop_recording(self, timeout: float = 5.0) -> tuple[Path, RecorderStatus]:
        """Finish the session; return its folder and how it ended.

        Raises
        ------
        SessionError
            When none is being recorded.
        """
        with self._lock:
            if self._outlet.folder is not None:
                self._event("recording stopped")
            session = self._outlet.detach()
        # Not under the lock: a slow disk must not hold up the ticks.
        return session.folder, self._outlet.finish(session, timeout)

    def record(self, channel: Channel, data: bytes) -> None:
        """Record a message at the present simulated time, if a session is being recorded."""
        self._outlet.record(self.stamp, channel, data)

    def event(self, event: str, **details: object) -> None:
        """Record that something happened."""
        with self._lock:
            self._event(event, **details)

    def _event(self, event: str, **details: object) -> None:
        details = {"time": self.time, "ticks": self.ticks, **details}
        self._outlet.emit(self.stamp, ((event, details), encoding.EVENT_ENCODERS))

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
        self._outlet.publish(channels.CLOCK, cdr.clock, stamp)
        self._outlet.emit(
            stamp,
            (observation, self._encoders),
            (motion, self._motion_encoders[motion.kind]),
            (self._simulator.statistics.last_tick_time, encoding.TICK_TIME_ENCODERS),
        )

    def _step(self) -> tuple[Observation, Motion] | None:
        """Step by the command in force, or stand still where the simulator refuses it."""
        motion = self.commands.motion(self._position, self._orientation, self.time, self.period)
        try:
            return self._simulator.step(motion.command(), self.period), motion
        except NeedleSimError as error:
            self.commands.refuse_current(type(error).__name__)
            self._event("command refused", reason=str(error))
            self._warn(f"command refused: {error}")
        try:
            return self._simulator.step(STILL.command(), self.period), STILL
        except NeedleSimError as error:
            self.failed_ticks += 1
            self.last_failure = str(error)
            return None


def changed_scene(scene: Scene, changes: Mapping[str, object]) -> Scene:
    """Return a scene with interaction laws changed, by keys below `interaction`.

    Raises
    ------
    SceneError
        When that is not admissible.
    """
    return _changed(scene, tuple(sorted(changes.items())))


@lru_cache(maxsize=1)  # who changes a scene has asked before whether it may be
def _changed(scene: Scene, changes: tuple[tuple[str, object], ...]) -> Scene:
    return scene.with_changes({f"interaction.{key}": value for key, value in changes})
