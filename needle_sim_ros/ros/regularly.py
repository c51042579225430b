# SPDX-License-Identifier: Apache-2.0
"""What is due now and then, in a thread of its own that keeps out of the ticks' way.

A timer of the node's would do, but rclpy's executor takes a millisecond or two of Python to
find out which of a node's timers and services is due, and a tick waits for it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

Pause = Callable[[], object]
Job = Callable[[Pause], object]


class Regularly:
    """Does jobs at their periods until closed; the first time at once.

    Parameters
    ----------
    jobs : dict of Job to float
        Period of each, s. A job calls what it is given between pieces of its work.
    pause : callable
        That: may wait a little for something more urgent.
    failed : callable
        Told what a job raises; the others go on.
    """

    def __init__(
        self, jobs: dict[Job, float], pause: Pause, failed: Callable[[Exception], object]
    ) -> None:
        self._periods, self._pause, self._failed = jobs, pause, failed
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="regularly", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End after the job under way; may be called again."""
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        due = dict.fromkeys(self._periods, time.monotonic())
        while not self._closing.wait(max(0.0, min(due.values()) - time.monotonic())):
            job = min(due, key=lambda one: due[one])
            due[job] = time.monotonic() + self._periods[job]
            self._pause()
            try:
                job(self._pause)
            except Exception as error:  # whatever it is, it must not end the others
                self._failed(error)
