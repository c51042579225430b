# SPDX-License-Identifier: Apache-2.0
"""What the machine itself withholds: a loop that only counts, as long as the node's tick takes.

Run as ``python -m needle_sim_ros.ros.soak.idle RATE BUSY SECONDS`` with nothing beside it; it
prints its ticks and overruns.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import time

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.clock_loop import ClockLoop
from needle_sim_ros.ros.priority import take_priority

_PATIENCE = 30.0  # s beyond the time that it runs
_TRIES = 50  # of which the quickest tells how fast the machine counts


def idle_overruns(rate: float, busy: float, seconds: float, priority: float) -> float:
    """Return the share of deadlines that a loop in a process of its own misses.

    Parameters
    ----------
    rate : float
        Hz.
    busy : float
        What each tick takes where nothing holds it up, s.
    seconds : float
        How long.
    priority : float
        As the node's ``realtime_priority``.
    """
    arguments = [repr(value) for value in (rate, busy, seconds, priority)]
    done = subprocess.run(
        [sys.executable, "-m", __name__, *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=seconds + _PATIENCE,
    )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise NeedleSimError(f"the idle loop ended: {lines[-1]}")
    ticks, overruns = (int(word) for word in done.stdout.split())
    return overruns / max(1, ticks + overruns)


def _count(number: int) -> None:
    for _ in range(number):
        pass


def _numbers_in(busy: float) -> int:
    """Return how far to count for a time, s."""
    number, quickest = 10_000, float("inf")
    for _ in range(_TRIES):
        began = time.perf_counter()
        _count(number)
        quickest = min(quickest, time.perf_counter() - began)
    return round(number * busy / quickest)


def _main(rate: float, busy: float, seconds: float, priority: float) -> None:
    number = _numbers_in(busy)
    loop = ClockLoop(lambda: _count(number), 1.0 / rate)
    failed = threading.Event()
    loop.start(lambda error: failed.set(), lambda: take_priority(priority))
    failed.wait(seconds)
    loop.stop()
    if loop.error is not None:
        raise loop.error
    print(loop.ticks, loop.overruns)


if __name__ == "__main__":
    _main(*(float(word) for word in sys.argv[1:]))
