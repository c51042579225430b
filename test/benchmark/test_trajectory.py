# SPDX-License-Identifier: Apache-2.0
"""Errors of made-up runs whose differences are known."""

import numpy as np
import pytest

from needle_sim_ros.benchmark.trajectory import QUANTITIES, Trajectory, errors


def run(step, count, value):
    time = step * np.arange(1, count + 1)
    values = np.zeros((count, 1, 3))
    values[:, 0, 0] = value(time)
    return Trajectory(time, dict.fromkeys(QUANTITIES, values))


def test_relative_to_the_largest_magnitude_of_the_reference():
    reference, off = run(0.1, 100, lambda t: 4 * t), run(0.1, 100, lambda t: 4 * t + 0.8 * (t > 5))
    found = errors(off, reference)
    assert found.worst == pytest.approx(0.8 / 40)
    assert found.rms["markers"] == pytest.approx(0.8 / 40 / np.sqrt(2))
    assert errors(reference, reference).worst == 0


@pytest.mark.parametrize("steps", [(0.1, 0.05), (0.05, 0.1)])
def test_equal_times_whichever_has_the_longer_ticks(steps):
    one, other = (run(dt, round(10 / dt), np.sin) for dt in steps)
    assert errors(one, other).worst < 1e-12


def test_a_jump_a_tick_late_counts_but_not_within_a_tick():
    reference, late = (run(0.1, 100, lambda t, at=at: 1.0 * (t > at)) for at in (4.95, 5.05))
    found = errors(late, reference)
    assert found.worst == 1
    assert max(found.late.values()) == 0


def test_markers_count_each_for_itself():
    time = np.array([1.0, 2.0])
    here = np.zeros((2, 2, 3))
    here[:, 0, 0] = 2.0
    there = here.copy()
    there[1, 1, 2] = 1.0
    found = errors(Trajectory(time, {"markers": there}), Trajectory(time, {"markers": here}))
    assert found.largest == {"markers": 0.5}
    assert found.rms["markers"] == pytest.approx(0.5 / np.sqrt(2))
