# SPDX-License-Identifier: Apache-2.0
"""Planning in a process of its own: whoever asks never shares a core's lock with it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.parallel import end_with_parent, one_thread_each
from needle_sim_ros.planning.continuation import (
    Continuation,
    Pose,
    follow,
    steer,
)
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.planner import Planner
from needle_sim_ros.planning.quick import QuickSimulator, planning_scene
from needle_sim_ros.planning.task import TOLERANCE, Task, check
from needle_sim_ros.scene import Interaction, Scene

_NICE = 10
_REACH = 4e-3  # m, half width of the fine mesh about the scene's path


@dataclass(frozen=True)
class Running:
    """The state of a running simulation, as what has led there.

    Attributes
    ----------
    poses : tuple of Pose
        Of the base, from the start.
    interaction : Interaction
        Laws now in force.
    """

    poses: tuple[Pose, ...]
    interaction: Interaction


@dataclass(frozen=True)
class PlanRequest:
    """Find how to go on to a target (3,), m."""

    running: Running
    target: tuple[float, ...]
    speed: float


@dataclass(frozen=True)
class PredictRequest:
    """Tell where the tip goes when the base follows poses from where it is."""

    running: Running
    poses: tuple[Pose, ...]


@dataclass(frozen=True)
class PlanAnswer:
    """Way of the base; the miss at its end, m."""

    poses: tuple[Pose, ...]
    miss: float


class PlanningWorker:
    """Answers requests about one scene; lives in the planning process.

    Parameters
    ----------
    scene : Scene
        Of the running simulation.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._base = QuickSimulator(planning_scene(scene, _REACH))

    def answer(self, request: PlanRequest | PredictRequest) -> PlanAnswer | Vector:
        """Answer a request.

        Raises
        ------
        NeedleSimError
            When it cannot be answered.
        """
        if isinstance(request, PredictRequest):
            simulator = self._led_to(request.running)
            return follow(simulator, _timed(request.poses))
        return self._plan(request)

    def _simulator(self, interaction: Interaction) -> QuickSimulator:
        if interaction == self._base.scene.interaction:
            self._base.reset()
            return self._base
        laws = replace(self._base.scene, interaction=interaction).to_dict()["interaction"]
        return self._base.changed({"interaction": laws})

    def _led_to(self, running: Running) -> QuickSimulator:
        simulator = self._simulator(running.interaction)
        follow(simulator, running.poses)
        return simulator

    def _plan(self, request: PlanRequest) -> PlanAnswer:
        x, y, z = request.target
        vary = ("offset",) if self._scene.dimension == 2 else ("offset", "roll")
        task = Task((x, y, z), vary, tolerance=TOLERANCE[self._scene.dimension])
        check(task, self._scene)
        simulator = self._led_to(request.running)
        if simulator.inserted > 0:
            point = simulator.material_point(request.target)
            found, outcome = steer(simulator, point, request.speed)
            _within(outcome.miss, task)
            return PlanAnswer(tuple(found.poses()), outcome.miss)
        return self._from_outside(request, task)

    def _from_outside(self, request: PlanRequest, task: Task) -> PlanAnswer:
        """Plan an insertion with the base's present orientation, its entry free."""
        last = request.running.poses[-1]
        axis = rotation_matrix(last.orientation)[:, 2]
        tip = np.array(last.position) + self._scene.needle.length * axis
        if tip[2] <= 0:
            raise NeedleSimError("the needle presses on the surface: go on or draw back first")
        facing = self._scene.with_changes(
            {
                "base.position": list(last.position),
                "base.orientation": list(last.orientation),
                "protocol": [],
                "interaction": replace(
                    self._scene, interaction=request.running.interaction
                ).to_dict()["interaction"],
            }
        )
        free = replace(task, vary=("entry",))
        plan = Planner.towards(facing, free).plan(free)
        _within(plan.outcome.miss, task)
        insertion = replace(plan.insertion, speed=request.speed)
        return PlanAnswer(tuple(_way(last, insertion)), plan.outcome.miss)


def _within(miss: float, task: Task) -> None:
    if miss > task.tolerance:
        raise NeedleSimError(f"not reachable from here: the nearest miss is {miss:.3g} m")


def _way(start: Pose, insertion: Insertion) -> list[Pose]:
    """Return the way over the entry and in: aside at the height where the base is, then down."""
    here = np.array(start.position)
    axis = insertion.axis
    above = float((insertion.place(0.0) - here) @ axis)
    begin = insertion.place(0.0) - above * axis
    along = Continuation(
        length=insertion.length,
        speed=insertion.speed,
        position=tuple(begin.tolist()),
        orientation=start.orientation,
        travel=above + insertion.travel,
    )
    aside = float(np.linalg.norm(begin - here)) / insertion.speed
    return [start] + [replace(pose, time=pose.time + aside) for pose in along.poses()]


def _timed(poses: Sequence[Pose]) -> Sequence[Pose]:
    """Give poses that tell no times those of a slow stage: the order counts, not the speed."""
    if len(poses) < 2 or poses[-1].time > poses[0].time:
        return poses
    return [replace(pose, time=float(k)) for k, pose in enumerate(poses)]


def _serve(connection: Connection, scene: Scene) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks says when it is over
    end_with_parent()
    os.nice(_NICE)
    worker: PlanningWorker | None = None
    while True:
        try:
            request = connection.recv()
        except (EOFError, OSError):
            return
        try:
            if worker is None:
                worker = PlanningWorker(scene)
            reply: Any = worker.answer(request)
        except NeedleSimError as error:
            reply = NeedleSimError(str(error))
        except Exception as error:
            reply = NeedleSimError(f"planning failed: {error!r}")
        connection.send(reply)


class PlanningProcess:
    """A planning worker in a process of lower priority, started when first asked.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._process: Any = None
        self._connection: Connection | None = None
        self._lock = threading.Lock()  # of starting and ending: asked and closed by two threads

    def ask(self, request: PlanRequest | PredictRequest) -> Any:
        """Return the answer; blocks, without holding the interpreter, until it is there.

        Raises
        ------
        NeedleSimError
            What the worker says, or that it has ended.
        """
        try:
            connection = self._started()
            connection.send(request)
            reply = connection.recv()
        except (EOFError, OSError):
            self.close()
            raise NeedleSimError("the planning process has ended; ask again") from None
        if isinstance(reply, NeedleSimError):
            raise reply
        return reply

    def _started(self) -> Connection:
        with self._lock:
            if self._connection is None:
                context = get_context("spawn")
                ours, theirs = context.Pipe()
                with one_thread_each():
                    self._process = context.Process(
                        target=_serve, args=(theirs, self._scene), daemon=True, name="planning"
                    )
                    self._process.start()
                theirs.close()  # so that its end is seen here
                self._connection = ours
            return self._connection

    def close(self) -> None:
        """End the process, whatever it does."""
        with self._lock:
            process, connection = self._process, self._connection
            self._process = self._connection = None
        if process is not None:
            process.terminate()
            process.join()
            process.close()
        if connection is not None:
            connection.close()
