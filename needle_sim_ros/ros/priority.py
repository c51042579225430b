# SPDX-License-Identifier: Apache-2.0
"""Precedence of the clock loop's thread over other threads and processes."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable

from needle_sim_ros.ros.threads import for_each_thread


def take_priority(priority: float) -> str:
    """Make the calling thread a real-time thread; return what came of it.

    Parameters
    ----------
    priority : float
        Of SCHED_FIFO, 1 to 99; where that is not permitted (it takes CAP_SYS_NICE or an
        rtprio limit), the least nice value that is. 0 changes nothing.

    Returns
    -------
    str
        As ``/diagnostics`` says it.
    """
    if not priority:
        return "normal"
    if hasattr(os, "sched_setscheduler"):
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(round(priority)))
        except OSError as error:
            refused = error.strerror
        else:
            return f"SCHED_FIFO {round(priority)}"
    else:
        refused = "the system has no SCHED_FIFO"
    for nice in (-20, -10, -5):  # of this thread: on Linux it is a thread that is nice
        try:
            os.setpriority(os.PRIO_PROCESS, 0, nice)
        except OSError:
            continue
        return f"nice {nice} (SCHED_FIFO: {refused})"
    return f"normal (SCHED_FIFO: {refused})"


def raise_middleware(priority: float) -> None:
    """Make real-time threads of those that Python did not start, where that is permitted.

    They are the middleware's, and hold locks that publishing waits for.

    Parameters
    ----------
    priority : float
        Of SCHED_FIFO; below 1 nothing changes.
    """
    if priority < 1 or not hasattr(os, "sched_setscheduler"):
        return
    known = {thread.native_id for thread in threading.enumerate()}
    wanted = os.sched_param(round(priority))

    def lift(thread: int) -> None:
        if thread not in known:
            os.sched_setscheduler(thread, os.SCHED_FIFO, wanted)

    with contextlib.suppress(PermissionError):
        for_each_thread(lift)


_TICK_INTERVAL = 5e-3  # s, longer than a tick


def uninterrupted(tick: Callable[[], object]) -> Callable[[], None]:
    """Return a tick during which other threads do not ask for the interpreter lock.

    A thread that waits for the lock asks its holder to give it up every switch interval.
    The node's is short, so that the tick gets the lock soon; but nobody who waits during a
    tick can do anything for that tick any more.
    """
    usual = sys.getswitchinterval()

    def run() -> None:
        sys.setswitchinterval(_TICK_INTERVAL)
        try:
            tick()
        finally:
            sys.setswitchinterval(usual)

    return run
