# SPDX-License-Identifier: Apache-2.0
"""Precedence of the clock loop's thread over everything else on its processor."""

from __future__ import annotations

import os


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
