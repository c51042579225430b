# SPDX-License-Identifier: Apache-2.0
"""A processor that one thread has to itself, and the waiting on it."""

import os
import threading
import time

import pytest

pytest.importorskip("rclpy")
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros import own_core
from needle_sim_ros.ros.own_core import OwnCore, why_not

MINE = os.sched_getaffinity(0)
CORE = max(MINE)
able = pytest.mark.skipif(bool(why_not(CORE)), reason=f"here it cannot be had: {why_not(CORE)}")


@able
def test_others_keep_off_it_until_it_is_given_back():
    core, taken, release = OwnCore(CORE, 1e-3), threading.Event(), threading.Event()
    seen = {}

    def run():
        seen["said"] = core.take()
        seen["own"] = os.sched_getaffinity(0)
        taken.set()
        release.wait()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        assert taken.wait(10)
        assert seen["own"] == {CORE}
        assert os.sched_getaffinity(0) == MINE - {CORE}
        assert seen["said"] == f"processor {CORE} to itself"
    finally:
        core.give_back()
        release.set()
        thread.join()
    assert os.sched_getaffinity(0) == MINE


@able
@pytest.mark.parametrize("seconds", [0.0, 1e-5, 2e-3, 2e-2])
def test_it_waits_for_as_long_as_told(seconds):
    core = OwnCore(CORE, 1e-3)
    begun = time.monotonic()
    core.wait(seconds)
    assert time.monotonic() - begun >= seconds - 1e-9


@able
def test_others_run_while_it_waits():
    core, reached = OwnCore(CORE, 1e-3), []

    def run():
        for _ in range(20):
            reached.append(time.monotonic())
            time.sleep(1e-3)

    thread = threading.Thread(target=run)
    begun = time.monotonic()
    thread.start()
    core.wait(0.5)
    ended = time.monotonic()
    thread.join()
    assert sum(begun < when < ended for when in reached) > 1


def test_what_cannot_be_had_is_said(monkeypatch):
    assert str(sorted(MINE)) in why_not(max(MINE) + 1)
    monkeypatch.setattr(os, "sched_getaffinity", lambda thread: {3})
    assert why_not(3) == "the node's other threads need another processor"
    monkeypatch.setattr(os, "sched_getaffinity", lambda thread: {3, 4})
    monkeypatch.setattr(own_core, "_wait", None)
    assert "compiler" in why_not(3)


@able
def test_the_node_s_clock_loop_has_it_while_it_runs(cell):
    cell.start(paused=False, dedicated_core=CORE)
    assert cell.priority("processor").endswith(f"processor {CORE} to itself")
    assert CORE not in os.sched_getaffinity(0)
    cell.sim.simulation.destroy()
    assert os.sched_getaffinity(0) == MINE


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"dedicated_core": 4096}, "dedicated_core = 4096: must be one of the processors"),
        ({"dedicated_core": -2}, "dedicated_core = -2: must be one of the processors"),
        ({"dedicated_core": 1.0}, "dedicated_core = 1.0 is of type double"),
        ({"dedicated_core": CORE, "use_sim_time": True}, "use_sim_time waits for another clock"),
    ],
)
def test_a_start_on_one_that_cannot_be_had_is_refused(cell, parameters, message):
    with pytest.raises(NeedleSimError, match=message):
        cell.start(**parameters)
    assert os.sched_getaffinity(0) == MINE
