# SPDX-License-Identifier: Apache-2.0
"""Processors that do not fall asleep between ticks, though everybody may use them.

A processor with nothing to do halts; under a hypervisor others get it then. The tick that wakes
it begins late, on caches that are cold. A thread of the least precedence that there is (Linux's
SCHED_IDLE) on each of them prevents that, and gives way to whoever wants it at once.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable

try:
    from needle_sim_ros.ros import _wait
except ImportError:  # built without a compiler, or run from the source
    _wait = None  # type: ignore[assignment]


def why_not() -> str:
    """Return why processors cannot be kept awake, or nothing."""
    if not hasattr(os, "SCHED_IDLE"):
        return "this system has no precedence below all others (SCHED_IDLE)"
    if _wait is None:
        return "needs the package's compiled part: install with a C compiler"
    return ""


class Awake:
    """Keeps the processors awake that this process may run on, from now until :meth:`end`.

    Parameters
    ----------
    warn : callable
        Told of each processor with which it does not work.
    """

    def __init__(self, warn: Callable[[str], object]) -> None:
        self._warn = warn
        self._over = bytearray(1)
        self._threads = [
            threading.Thread(target=self._keep, args=(core,), name="awake", daemon=True)
            for core in sorted(os.sched_getaffinity(0))
        ]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Let them sleep; may be called again."""
        self._over[0] = 1
        for thread in self._threads:
            thread.join()

    def _keep(self, core: int) -> None:
        try:
            _wait.stay_awake(core, self._over)
        except OSError as error:
            self._warn(f"processor {core} is not kept awake: {error.strerror}")
