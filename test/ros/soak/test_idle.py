# SPDX-License-Identifier: Apache-2.0
"""The loop that tells what the machine withholds."""

import pytest

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.soak.idle import idle_overruns


def test_a_loop_with_little_to_do_keeps_its_rate():
    """A hundredth of the period: only a machine that stands still makes it miss deadlines."""
    assert idle_overruns(50.0, 2e-4, 1.0, 0.0) < 0.5


def test_a_loop_with_too_much_to_do_misses_what_it_must():
    """Four and a half periods a tick: most deadlines, even where the machine gets faster."""
    assert idle_overruns(100.0, 45e-3, 1.0, 0.0) >= 0.6


def test_a_loop_that_fails_says_why():
    with pytest.raises(NeedleSimError, match="idle loop ended"):
        idle_overruns(0.0, 1e-3, 1.0, 0.0)
