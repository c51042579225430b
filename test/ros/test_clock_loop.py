# SPDX-License-Identifier: Apache-2.0
"""Deadlines, overruns and pauses of the clock loop, by a clock that the tests move."""

import threading
import time
from itertools import pairwise

import pytest

from needle_sim_ros.ros.clock_loop import ClockLoop

MS = 1_000_000


class Clock:
    """A clock that only sleeping and working move; ends the loop after some ticks."""

    def __init__(self, work_ms, ticks, period_ms=10):
        self.time = 12345 * MS
        self.work = list(work_ms)
        self.starts = []
        self.limit = ticks
        self.loop = ClockLoop(self.tick, period_ms / 1000, now=lambda: self.time, sleep=self.sleep)

    def sleep(self, seconds):
        self.time += max(1, round(seconds * 1e9))

    def tick(self):
        self.starts.append((self.time - 12345 * MS) / MS)
        self.time += round((self.work.pop(0) if self.work else 1) * MS)
        if len(self.starts) == self.limit:
            self.loop.stop()

    def run(self):
        self.loop.run()
        return self.starts


def test_ticks_start_on_absolute_deadlines_whatever_they_take():
    clock = Clock(work_ms=[1, 9, 3, 7, 2], ticks=5)
    assert clock.run() == [10, 20, 30, 40, 50]
    assert clock.loop.overruns == 0


@pytest.mark.parametrize(
    "late_ms, next_start, overruns",
    [(9.999, 30, 0), (10, 30, 0), (10.001, 40, 1), (20, 40, 1), (20.001, 50, 2), (995, 1020, 99)],
)
def test_an_overrun_is_counted_and_never_followed_by_a_burst(late_ms, next_start, overruns):
    clock = Clock(work_ms=[1, late_ms, 1, 1], ticks=4)
    assert clock.run() == [10, 20, next_start, next_start + 10]
    assert clock.loop.overruns == overruns


def test_every_deadline_is_either_a_tick_or_an_overrun():
    clock = Clock(work_ms=[3, 25, 1, 11, 40, 2] * 10, ticks=60)
    starts = clock.run()
    gaps = [b - a for a, b in pairwise(starts)]
    assert min(gaps) == 10
    deadlines = round((starts[-1] - starts[0]) / 10) + 1
    assert deadlines == clock.loop.ticks + clock.loop.overruns


def test_a_clock_that_jumps_back_starts_afresh():
    clock = Clock(work_ms=[1, -5000, 1], ticks=3)
    starts = clock.run()
    assert starts[:2] == [10, 20]
    assert starts[2] == 20 - 5000 + 10


def test_the_report_is_about_the_latest_ticks():
    clock = Clock(work_ms=[1] * 30, ticks=30)
    assert clock.loop.report().ticks == 0
    clock.run()
    report = clock.loop.report()
    assert report.ticks == 30
    assert 0 < report.tick_p50 <= report.tick_p99 <= report.tick_max < 0.1
    assert report.lateness_p99 == 0


def test_a_paused_loop_stands_still_and_resumes_without_a_burst():
    ticked = threading.Event()
    starts = []

    def tick():
        starts.append(time.monotonic())
        ticked.set()

    loop = ClockLoop(tick, 0.02)
    loop.start(lambda error: None)
    assert ticked.wait(10)
    loop.pause()
    assert loop.paused
    time.sleep(0.1)
    count = len(starts)
    ticked.clear()
    assert not ticked.wait(0.1)
    assert len(starts) == count
    resumed = time.monotonic()
    loop.resume()
    assert ticked.wait(10)
    loop.stop()
    assert starts[count] - resumed > 0.015


def test_what_a_tick_raises_ends_the_loop_and_is_told():
    told = threading.Event()
    loop = ClockLoop(lambda: 1 / 0, 0.001)
    loop.start(lambda error: told.set())
    assert told.wait(10)
    assert isinstance(loop.error, ZeroDivisionError)
    loop.stop()


def test_it_says_how_long_there_is_until_the_next_deadline():
    clock = Clock(work_ms=[1], ticks=1)
    left = []
    clock.loop._sleep = lambda seconds: (left.append(clock.loop.time_left), clock.sleep(seconds))
    clock.run()
    assert left == [pytest.approx(0.01)]
    clock.time += 4 * MS
    assert clock.loop.time_left == pytest.approx(0.005)  # of ten, one went by in the tick
