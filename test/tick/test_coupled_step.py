# SPDX-License-Identifier: Apache-2.0
"""A step of needle and tissue together: what it returns, and what it leaves as it was."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, CommandError
from needle_sim_ros.tick.base_motion import commanded
from needle_sim_ros.tick.coupled_step import Coupled
from needle_sim_ros.tick.route import Route

NEWMARK = {"solver.dynamics": "newmark", "solver.time_step": 0.05, "solver.modes": 20}


def begun(simulator, changes, velocity, dt=0.05):
    sim = simulator(changes)
    for _ in range(round(5.0 / dt)):
        sim.step(BaseCommand(velocity=[0, 0, -3e-3]), dt)
    state = sim.snapshot()
    motion = commanded(BaseCommand(velocity=velocity), state.position, state.orientation, dt)
    route = Route(state.position, state.orientation, state.pose, motion, dt)
    return sim, Coupled(state.contact, state.tissue, state.pose), route


@pytest.mark.parametrize("changes", [{}, NEWMARK])
def test_it_is_what_a_tick_does(simulator, changes):
    """The simulator's own tick of the same command, to the bit; the start is not touched."""
    velocity = [0.0, 0.0, -3e-3]
    sim, here, route = begun(simulator, changes, velocity)
    before = here.contact.moved.copy()
    after, advance, count = sim._stepper.carry_out(here, route, (0.0, 1.0), 1, False)
    np.testing.assert_array_equal(here.contact.moved, before)
    seen = sim.step(BaseCommand(velocity=velocity), 0.05)
    assert advance == pytest.approx(1.5e-4)
    assert count == sim.snapshot().parts == 1
    assert after.contact.depth == seen.insertion_depth
    np.testing.assert_array_equal(after.contact.forces, sim.snapshot().contact.forces)


def test_newmark_takes_a_long_way_in_parts(simulator):
    """1.5 spacings: at least three parts, and one more where the track is aimed."""
    longer = {**NEWMARK, "solver.time_step": 0.2}
    sim, here, route = begun(simulator, longer, [0.0, 0.0, -15e-3], 0.2)
    after, advance, count = sim._stepper.carry_out(here, route, (0.0, 1.0), 0, False)
    assert count >= 4
    assert advance == pytest.approx(3e-3)
    assert after.contact.depth > here.contact.depth + 2.5e-3


def test_too_long_a_way_is_refused(simulator):
    sim, here, route = begun(simulator, NEWMARK, [0.0, 0.0, -0.1])
    with pytest.raises(CommandError, match="time_step is too long"):
        sim._stepper.carry_out(here, route, (0.0, 1.0), 0, False)
