# SPDX-License-Identifier: Apache-2.0
"""The online estimator in a process of its own: whoever feeds it never waits for it."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from multiprocessing import get_context
from typing import Any

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.online import ONLINE, Estimate, Estimator
from needle_sim_ros.parallel import end_with_parent, one_thread_each
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.motion import Motion

_BATCH = 20  # entries sent at once
_MOST_WAITING = 100_000  # entries kept when the process does not keep up; beyond, it is given up
_PATIENCE = 1.0  # s between looks whether the parent is still there
_RESULTS = 8


class EstimatorProcess:
    """An :class:`~needle_sim_ros.identify.online.Estimator` fed from a loop that must not wait.

    Every method but `close` returns at once: entries are put aside in batches that another
    thread sends. Commands and measurements may come from different threads.

    Parameters
    ----------
    scene, tick_period, parameters, noise
        As of the estimator.
    """

    def __init__(
        self,
        scene: Scene,
        tick_period: float,
        parameters: Sequence[str] = ONLINE,
        noise: Mapping[str, float] | None = None,
    ) -> None:
        context = get_context("spawn")
        self._entries: list[tuple[Any, ...]] = []
        self._lock = threading.Lock()
        self._tasks: Any = context.Queue(200)
        self._results: Any = context.Queue(_RESULTS)
        self._latest: Estimate | None = None
        self.problem = ""
        arguments = (scene.to_yaml(), tick_period, tuple(parameters), dict(noise or {}))
        with one_thread_each():
            self._process = context.Process(
                target=_work,
                args=(self._tasks, self._results, os.getpid(), *arguments),
                name="identify",
                daemon=True,
            )
            self._process.start()

    def tick(self, motion: Motion) -> None:
        """Follow one tick of the base."""
        self._put(("tick", motion))

    def measure(
        self, time: float, force: Sequence[float] | None = None, markers: Vector | None = None
    ) -> None:
        """Take a measurement in; see the estimator."""
        self._put(("measure", time, force, markers))

    def reset(self) -> None:
        """Begin an insertion anew."""
        with self._lock:
            self._entries.append(("reset",))
            self._send()

    def _put(self, entry: tuple[Any, ...]) -> None:
        if self.problem:
            return
        with self._lock:
            self._entries.append(entry)
            if len(self._entries) >= _BATCH:
                self._send()

    def _send(self) -> None:
        try:
            self._tasks.put_nowait(self._entries)
            self._entries = []
        except queue.Full:
            if len(self._entries) > _MOST_WAITING:
                self.problem = "identification fell behind and was given up"
                self._entries = []

    def latest(self) -> Estimate | None:
        """Return the newest estimate; None before the first. Sets ``problem`` when it failed."""
        while True:
            try:
                found = self._results.get_nowait()
            except queue.Empty:
                break
            if isinstance(found, str):
                self.problem = found
            else:
                self._latest = found
        if not self.problem and not self._process.is_alive():
            self.problem = f"identification ended with status {self._process.exitcode}"
        return self._latest

    def close(self, timeout: float = 2.0) -> None:
        """End the process."""
        self._entries = []
        with suppress(queue.Full):
            self._tasks.put_nowait(None)
        self._process.join(timeout)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()
        for channel in (self._tasks, self._results):
            channel.cancel_join_thread()
            channel.close()


def _work(
    tasks: Any,
    results: Any,
    parent: int,
    scene_text: str,
    tick_period: float,
    parameters: Sequence[str],
    noise: Mapping[str, float],
) -> None:
    """Estimate until told to stop, or until the parent is gone."""
    end_with_parent()
    if hasattr(os, "nice"):
        os.nice(10)
    try:
        estimator = Estimator(Scene.from_yaml(scene_text), tick_period, parameters, noise)
        while os.getppid() == parent:
            try:
                batch = tasks.get(timeout=_PATIENCE)
            except queue.Empty:
                continue
            while batch is not None:
                for name, *arguments in batch:
                    getattr(estimator, name)(*arguments)
                try:
                    batch = tasks.get_nowait()  # catch up before the next estimate
                except queue.Empty:
                    break
            if batch is None:
                return
            try:
                results.put_nowait(estimator.estimate())
            except queue.Full:
                continue  # nobody asks at present
    except KeyboardInterrupt:
        return
    except NeedleSimError as error:
        results.put(f"identification ended: {error}")
