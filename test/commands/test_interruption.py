# SPDX-License-Identifier: Apache-2.0
"""Signals are kept until they can be acted on."""

import os
import signal

import pytest

from needle_sim_ros.commands.interruption import Interruption


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_first_signal_waits_for_the_check_and_the_second_does_not(number):
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), Interruption() as interruption:
        interruption.check()
        os.kill(os.getpid(), number)
        with pytest.raises(KeyboardInterrupt):
            interruption.check()
        os.kill(os.getpid(), number)
        pytest.fail("the second signal was kept too")
    assert signal.getsignal(number) is before


def test_a_signal_that_no_check_saw_is_not_lost():
    with pytest.raises(KeyboardInterrupt), Interruption():
        os.kill(os.getpid(), signal.SIGTERM)


def test_nothing_happens_without_a_signal():
    with Interruption() as interruption:
        interruption.check()
