# SPDX-License-Identifier: Apache-2.0
"""How far the base may go in a time step, and what is said where it would go farther."""

import pytest

from needle_sim_ros import BaseCommand, CommandError
from needle_sim_ros.tick.reach import Reach

SPACING = 2e-3  # of the coarse scene


def inserted(simulator):
    for _ in range(100):
        simulator.step(BaseCommand(velocity=[0, 0, -3e-3]), 0.05)
    return simulator.snapshot().contact


def test_newmark_steps_in_and_out_are_bounded(simulator):
    contact, reach = inserted(simulator()), Reach(SPACING, 1.0, "")
    reach.check(contact, 2 * SPACING, 2 * SPACING)
    reach.check(contact, -4 * SPACING, 4 * SPACING)
    for advance, most in ((2.1, 2), (-4.1, 4)):
        with pytest.raises(CommandError, match=f"{most} times solver.track_spacing.*time_step"):
            reach.check(contact, advance * SPACING, abs(advance) * SPACING)
    reach.check(simulator().snapshot().contact, 1.0, 1.0)


def test_steps_that_resolve_a_wave_are_bounded_in_any_direction(simulator, coarse_scene):
    """2 % of the 80 mm; a step longer than the wave's 0.14 s has no wave to resolve."""
    contact = inserted(simulator())
    reach = Reach.of(coarse_scene({"solver.time_step": 0.05}))
    reach.check(contact, 0.0, 1.6e-3)
    with pytest.raises(CommandError, match=r"0.0017 m in one time step, more than 0.0016 m, 2%"):
        reach.check(contact, 0.0, 1.7e-3)
    Reach.of(coarse_scene({"solver.time_step": 0.2})).check(contact, 0.0, 1.0)
