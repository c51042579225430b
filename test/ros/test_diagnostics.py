# SPDX-License-Identifier: Apache-2.0
"""What `/diagnostics` warns of, and what it gives with it."""

import os
import threading

import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from needle_sim_ros.ros.priority import take_priority


def loop_status(cell, arrays, text):
    """Wait until the clock loop says a text; return its status and values."""

    def found():
        for array in arrays:
            for status in array.status:
                if status.name == "needle_sim: clock loop" and status.message == text:
                    return status
        return None

    status = cell.until(found, text)
    return status, {pair.key: pair.value for pair in status.values}


def test_a_rate_that_is_not_held_is_said_with_the_figures(cell):
    cell.start(paused=False, rate=10_000.0)  # a tick takes longer than 0.1 ms
    arrays = cell.collect(DiagnosticArray, "/diagnostics")
    status, values = loop_status(cell, arrays, "the rate is not held")
    assert status.level == DiagnosticStatus.WARN
    assert int(values["overruns"]) > 0
    assert float(values["real_time_factor"]) < 1
    for name in ("tick", "lateness"):
        parts = [float(values[f"{name}_{part}_ms"]) for part in ("p50", "p99", "max")]
        assert parts == sorted(parts)
    assert int(values["solves"]) > 0
    assert int(values["waits_for_solves"]) >= 0
    assert values["prepared_beside_the_plan"] == "100%"  # in 2D there is nothing beside it
    assert values["priority"] == "normal"


def test_a_clock_that_stands_still_is_said(cell):
    cell.start(paused=False, use_sim_time=True)
    arrays = cell.collect(DiagnosticArray, "/diagnostics")
    status, values = loop_status(cell, arrays, "no tick since the last report")
    assert status.level == DiagnosticStatus.WARN
    assert values["ticks"] == "0"


@pytest.mark.parametrize("priority", [0.0, 7.0])
def test_the_thread_says_with_which_priority_it_runs(priority):
    said = []

    def run():
        said.append((take_priority(priority), os.sched_getscheduler(0)))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    (text, policy) = said[0]
    if not priority:
        assert text == "normal"
    elif policy == os.SCHED_FIFO:
        assert text == "SCHED_FIFO 7"
    else:  # not permitted here
        assert "SCHED_FIFO: " in text
    assert os.sched_getscheduler(0) == os.SCHED_OTHER  # only that thread's


def test_who_answers_a_service_is_not_held_up_by_other_processes(cell):
    """It holds the interpreter lock that the ticks wait for; the ticks still go first."""
    node = cell.start(realtime_priority=7.0)
    answering = cell.spinners[-1]._thread.native_id
    assert os.sched_getscheduler(answering) == os.SCHED_OTHER
    cell.step()
    cell.until(lambda: node.simulation.priority != "normal", "the clock loop's priority")
    if node.simulation.priority.startswith("SCHED_FIFO"):  # permitted here
        assert os.sched_getscheduler(answering) == os.SCHED_FIFO
        assert os.sched_getparam(answering).sched_priority == 6
