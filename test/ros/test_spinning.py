# SPDX-License-Identifier: Apache-2.0
"""A spinning node ends when told to, at whatever moment, and only then."""

import itertools
import sys

import pytest
import rclpy
from rclpy.clock import Clock
from std_srvs.srv import Trigger

from needle_sim_ros.ros.spinning import Spinning


@pytest.fixture
def brisk():
    """Let the threads take turns as often as the node does."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.usefixtures("brisk")
def test_it_stops_at_any_moment_without_an_error(cell):
    """As rclpy's executor does not: its shutdown takes from the thread what it is about to use."""
    ended, calls = [], itertools.count()
    node = rclpy.create_node("brief", context=cell.context)
    node.create_timer(1e-4, lambda: next(calls), clock=Clock())
    for number in range(300):
        spinning = Spinning(node, "brief", ended.append)
        for _ in range(100 * (number % 20)):
            next(calls)  # takes its time
        spinning.stop()
        assert not spinning._thread.is_alive()
    node.destroy_node()
    assert not ended


def test_a_stopped_one_may_be_stopped_again_and_answers_no_more(cell):
    node = rclpy.create_node("once", context=cell.context)
    node.create_service(Trigger, "once", lambda request, response: response)
    spinning = Spinning(node, "once")
    cell.call(Trigger, "/once")
    spinning.stop()
    spinning.stop()
    node.destroy_node()


def test_it_says_why_it_ended_by_itself(cell):
    """An error in a callback, or the end of the context."""
    ended = []

    def fail():
        raise RuntimeError("in a callback")

    node = rclpy.create_node("failing", context=cell.context)
    node.create_timer(1e-3, fail, clock=Clock())
    spinning = Spinning(node, "failing", ended.append)
    cell.until(lambda: ended)
    assert isinstance(ended[0], RuntimeError)
    spinning.stop()
    node.destroy_node()
