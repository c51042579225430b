# SPDX-License-Identifier: Apache-2.0
"""A processor that the clock loop has to itself, and does not leave between ticks.

Who sleeps until the next tick wakes up late and on a processor whose caches others have filled:
at 1 kHz that costs a tick half as much time again. On a core of its own the loop waits awake.
"""

from __future__ import annotations

import os
import threading

from needle_sim_ros.ros.threads import for_each_thread

try:
    from needle_sim_ros.ros import _wait
except ImportError:  # built without a compiler, or run from the source
    _wait = None  # type: ignore[assignment]

# part of a period that it sleeps at first: Linux takes a processor away from real-time threads
# that never do, for 50 ms in every second
_ASLEEP = 0.06


def why_not(core: int) -> str:
    """Return why a processor cannot be had, or nothing."""
    if not hasattr(os, "sched_setaffinity"):
        return "this system does not give processors to threads"
    mine = os.sched_getaffinity(0)
    if core not in mine:
        return f"must be one of the processors {sorted(mine)} that this process may run on"
    if len(mine) < 2:
        return "the node's other threads need another processor"
    if _wait is None:
        return "needs the package's compiled part: install with a C compiler"
    return ""


class OwnCore:
    """A processor for one thread of this process.

    Parameters
    ----------
    number : int
        Of the processor; `why_not` says nothing of it.
    period : float
        Of the ticks, s.
    """

    def __init__(self, number: int, period: float) -> None:
        self._number, self._asleep = number, _ASLEEP * period

    def take(self) -> str:
        """Bind the calling thread to it and keep the others off; return what to tell of it."""
        mine = threading.get_native_id()
        others = os.sched_getaffinity(0) - {self._number}
        for_each_thread(
            lambda one: os.sched_setaffinity(one, {self._number} if one == mine else others)
        )
        return f"processor {self._number} to itself"

    def give_back(self) -> None:
        """Let all threads use it again."""
        for_each_thread(
            lambda one: os.sched_setaffinity(one, os.sched_getaffinity(one) | {self._number})
        )

    def wait(self, seconds: float) -> None:
        """Wait without leaving the processor, but for a short sleep at first."""
        _wait.wait_awake(seconds, self._asleep)
