# SPDX-License-Identifier: Apache-2.0
"""Jobs that are due now and then, beside the ticks."""

import threading

import pytest

pytest.importorskip("rclpy")

from needle_sim_ros.ros.regularly import Regularly

DEADLINE = 30.0


class Counted:
    """A job that counts, and says when it has been done a number of times."""

    def __init__(self, enough, error=None):
        self.count, self.enough, self.error = 0, enough, error
        self.reached = threading.Event()

    def __call__(self, pause):
        self.count += 1
        pause()
        if self.count >= self.enough:
            self.reached.set()
        if self.error is not None:
            raise self.error


def test_jobs_are_done_at_their_periods_until_closed():
    often, once = Counted(5), Counted(1)
    pauses = []
    regularly = Regularly({often: 1e-3, once: 3600.0}, lambda: pauses.append(1), pytest.fail)
    assert often.reached.wait(DEADLINE)
    assert once.reached.wait(DEADLINE)
    regularly.close()
    regularly.close()
    done = often.count
    assert done >= 5
    assert once.count == 1
    assert len(pauses) == 2 * (done + 1)  # before each job, and when the job asks


def test_a_job_that_fails_is_told_of_and_the_others_go_on():
    told, good = [], Counted(4)
    bad = Counted(3, error=ValueError("no"))
    regularly = Regularly({bad: 1e-3, good: 1e-3}, lambda: None, told.append)
    assert bad.reached.wait(DEADLINE)
    assert good.reached.wait(DEADLINE)
    regularly.close()
    assert {str(error) for error in told} == {"no"}
    assert len(told) == bad.count
