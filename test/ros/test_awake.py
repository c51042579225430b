# SPDX-License-Identifier: Apache-2.0
"""Processors that are kept from sleeping, and give way to whoever wants them."""

import os
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros import awake
from needle_sim_ros.ros.awake import Awake, why_not

MINE = sorted(os.sched_getaffinity(0))
able = pytest.mark.skipif(bool(why_not()), reason=f"here it cannot be had: {why_not()}")


def keepers():
    """Processors of the threads of this process that keep one awake."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        number = int(task.name)
        if os.sched_getscheduler(number) == os.SCHED_IDLE:
            found += os.sched_getaffinity(number)
    return sorted(found)


def until(holds):
    end = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def kept():
    warned = []
    one = Awake(warned.append)
    until(lambda: keepers() == MINE)
    yield one
    one.end()
    assert warned == []


@able
def test_each_processor_has_a_thread_of_the_least_precedence(kept):
    assert keepers() == MINE
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert sorted(os.sched_getaffinity(0)) == MINE


@able
def test_none_of_them_is_left_in_the_end(kept):
    threads = [each for each in threading.enumerate() if each.name == "awake"]
    assert len(threads) == len(MINE)
    kept.end()
    assert keepers() == []
    assert not any(each.is_alive() for each in threads)
    kept.end()


@able
def test_others_go_before_them(kept):
    keeper = [each for each in threading.enumerate() if each.name == "awake"][-1]
    clock = time.pthread_getcpuclockid(keeper.ident)
    os.sched_setaffinity(0, {MINE[-1]})
    try:
        begun, used = time.clock_gettime(clock), time.thread_time()
        while time.thread_time() - used < 0.3:
            pass
        assert time.clock_gettime(clock) - begun < 0.1  # of one of my precedence: 0.3
    finally:
        os.sched_setaffinity(0, MINE)


@able
def test_a_processor_that_cannot_be_had_is_told_of(monkeypatch):
    warned = []
    with monkeypatch.context() as patch:
        patch.setattr(os, "sched_getaffinity", lambda thread: {1000})
        one = Awake(warned.append)
        one.end()
    assert warned == [f"processor 1000 is not kept awake: {os.strerror(22)}"]


def test_where_it_cannot_be_had_is_said(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(awake, "_wait", None)
        assert "compiler" in why_not()
    monkeypatch.delattr(os, "SCHED_IDLE")
    assert "SCHED_IDLE" in why_not()


@able
def test_the_node_keeps_them_awake_while_it_runs(cell):
    cell.start(paused=False, keep_awake=True)
    assert cell.priority("awake").endswith(", processors kept awake")
    assert keepers() == MINE
    cell.sim.simulation.destroy()
    assert keepers() == []


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"keep_awake": 1}, "keep_awake = 1 is of type integer"),
        (
            {"keep_awake": True, "dedicated_core": MINE[-1]},
            f"keep_awake = True: the loop waits awake on dedicated_core = {MINE[-1]}",
        ),
    ],
)
def test_a_start_with_what_makes_no_sense_is_refused(cell, parameters, message):
    if "dedicated_core" in parameters and len(MINE) < 2:
        pytest.skip("one processor")
    with pytest.raises(NeedleSimError, match=message):
        cell.start(**parameters)
    assert keepers() == []
