# SPDX-License-Identifier: Apache-2.0
"""A thread that ticks on absolute deadlines and keeps book of how well it does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_SECOND = 1_000_000_000
_PARTS = (50, 99, 100)  # per cent
_LONGEST_SLEEP = 0.05  # s, so that a stop is noticed at low rates


@dataclass(frozen=True)
class LoopReport:
    """How the loop did over its latest ticks.

    Parameters
    ----------
    ticks, overruns : int
        Since the start; an overrun is a deadline that passed without a tick.
    tick_p50, tick_p99, tick_max : float
        Time a tick took, s; NaN before the first.
    lateness_p50, lateness_p99, lateness_max : float
        How late ticks began after their deadlines, s.
    """

    ticks: int
    overruns: int
    tick_p50: float
    tick_p99: float
    tick_max: float
    lateness_p50: float
    lateness_p99: float
    lateness_max: float


class ClockLoop:
    """Calls `tick` every `period`; a late tick is never followed by a burst.

    A tick that ends after the next deadline skips to the next deadline to come, and
    every deadline skipped counts as an overrun. A clock that jumps back, or a loop that
    was paused, starts afresh from where the clock is.

    Parameters
    ----------
    tick : callable
        One tick. What it raises ends the loop and is kept in `error`.
    period : float
        s.
    now : callable
        Clock, ns; by default the steady clock.
    sleep : callable
        Waits for a time in s, or less.
    window : int
        Number of latest ticks that reports are about.
    """

    def __init__(
        self,
        tick: Callable[[], object],
        period: float,
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
        window: int = 2000,
    ) -> None:
        self._tick = tick
        self._period = round(period * _SECOND)
        self._now = now
        self._sleep = sleep
        self._took = np.zeros(window)
        self._late = np.zeros(window)
        self._stopping = False
        self._running = threading.Event()
        self._running.set()
        self._thread: threading.Thread | None = None
        self._deadline = self._now()
        self.ticks = 0
        self.overruns = 0
        self.error: BaseException | None = None

    @property
    def running(self) -> bool:
        """Whether its thread was started, paused or not."""
        return self._thread is not None

    @property
    def paused(self) -> bool:
        """Whether the loop stands still."""
        return not self._running.is_set()

    @property
    def time_left(self) -> float:
        """Time until the next deadline, s; meaningless while it stands still."""
        return (self._deadline - self._now()) / _SECOND

    def pause(self) -> None:
        """Stand still after the tick under way."""
        self._running.clear()

    def resume(self) -> None:
        """Tick again, from now on."""
        self._running.set()

    def start(
        self,
        on_error: Callable[[BaseException], object],
        before: Callable[[], object] = lambda: None,
    ) -> None:
        """Run in a thread of its own, after `before`; `on_error` is told what ended it."""

        def run() -> None:
            try:
                before()
                self.run()
            except BaseException as error:
                self.error = error
                on_error(error)

        self._thread = threading.Thread(target=run, name="clock loop", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End after the tick under way and wait for that."""
        self._stopping = True
        self._running.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def run(self) -> None:
        """Tick until stopped."""
        self._start_afresh()
        while not self._stopping:
            if self.paused:
                self._running.wait()
                self._start_afresh()
                continue
            remaining = self._deadline - self._now()
            if remaining > self._period:  # the clock jumped back
                self._start_afresh()
                continue
            if remaining > 0:
                self._sleep(min(remaining / _SECOND, _LONGEST_SLEEP))
                continue
            self._note(self._deadline)
            self._deadline += self._period
            missed = -((self._deadline - self._now()) // self._period)  # rounded up
            if missed > 0:
                self.overruns += missed
                self._deadline += missed * self._period

    def _start_afresh(self) -> None:
        self._deadline = self._now() + self._period

    def report(self) -> LoopReport:
        """Return how the loop did over its latest ticks."""
        n = min(self.ticks, len(self._took))
        if n == 0:
            return LoopReport(0, self.overruns, *(float("nan"),) * 6)
        took = np.percentile(self._took[:n], _PARTS).tolist()
        late = np.percentile(self._late[:n], _PARTS).tolist()
        return LoopReport(self.ticks, self.overruns, *took, *late)

    def _note(self, deadline: int) -> None:
        start, begun = self._now(), time.perf_counter()
        self._tick()
        slot = self.ticks % len(self._took)
        self._took[slot] = time.perf_counter() - begun
        self._late[slot] = (start - deadline) / _SECOND
        self.ticks += 1
