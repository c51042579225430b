# SPDX-License-Identifier: Apache-2.0
"""A tick in parts: the way, where it is divided, and what does not hang on the division."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_sim_ros import BaseCommand
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.interaction.state import AIMED, ContactState
from needle_sim_ros.scene import Friction
from needle_sim_ros.tick.base_motion import commanded
from needle_sim_ros.tick.division import (
    MOST,
    Division,
    caught,
    ends,
    static_parts,
    unsteady_parts,
)
from needle_sim_ros.tick.route import Route

PLACE = np.array([0.01, 0.0, 0.14])
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
SPACING = 2e-3  # of the coarse scene


@pytest.mark.parametrize(
    ("before", "after", "sticks"),
    [
        ([1, 1, 1], [1, 0, 1], True),
        ([-1, 1, 1], [0, 1, 1], True),
        ([0, 1, 1], [0, 1, 1], False),
        ([0, 1, 1], [1, -1, 1], False),
        ([1, 1, 1], [1, 1, 0], False),  # the tip
        ([1, 1], [1, 0, 1], False),  # a point that was not there
        ([1, 1, 1], [0, 1], True),
        ([], [0, 1], False),
        ([0, 1], [], False),
    ],
)
def test_points_that_slid_and_stick_are_caught(before, after, sticks):
    states = [ContactState(status=np.array(each, dtype=np.int8)) for each in (before, after)]
    assert caught(*states) is sticks


@given(st.floats(1e-6, 0.1))
def test_static_parts_are_short(advance):
    motion = commanded(BaseCommand(velocity=(0, 0, -advance)), PLACE, DOWN, 1.0)
    steps = static_parts(motion, 1e-3)
    assert advance / steps <= 0.5e-3 * (1 + 1e-6)
    assert steps == 1 or advance / (steps - 1) > 0.5e-3 * (1 - 1e-6)


def test_unsteady_parts_follow_the_slip_and_the_healing():
    friction = Friction(weakening_distance=5e-4, healing_time=0.1)
    assert unsteady_parts(1e-3, 1.0, friction, 1) == MOST
    assert unsteady_parts(1e-3, 0.1, friction, 1) == 10
    assert unsteady_parts(6e-3, 0.01, friction, 1) == 2
    assert unsteady_parts(0.0, 0.01, friction, 1) == 1
    assert unsteady_parts(0.0, 0.05, friction, 1) == 5
    assert unsteady_parts(0.0, 0.05, friction, 7) == 7


def inserted(simulator, ticks=100):
    for _ in range(ticks):
        simulator.step(BaseCommand(velocity=[0, 0, -3e-3]), 0.05)
    return simulator.snapshot().contact


def test_parts_end_where_the_tip_is_in_the_middle_of_a_segment(simulator):
    sim = simulator()
    contact = inserted(sim)
    while not 0.1 < (passed := contact.depth / SPACING - (contact.track.laid - 2)) < 0.3:
        contact = inserted(sim, 1)
    advance = 1.5 * SPACING
    first, last = ends(contact, advance)
    assert last == 1.0
    assert passed + first * contact.rate * advance / SPACING == pytest.approx(AIMED)
    assert list(ends(contact, 1e-3 * SPACING)) == [1.0]


def test_a_step_of_the_tissue_falls_in_parts(simulator):
    """Of half a track spacing; of a tenth of the healing time while friction recovers."""
    sim = simulator()
    law, contact = sim.scene.interaction.friction, inserted(sim)
    division = Division(sim.scene, sim._contact_laws)

    def parts(way, dt, jump=False, now=contact):
        pose = BasePose.of(PLACE, DOWN, 2)
        moved = commanded(BaseCommand(velocity=(0, 0, -way / dt)), PLACE, DOWN, dt)
        return division.of_step(now, Route(PLACE, DOWN, pose, moved, dt), 1.0, jump)

    assert parts(1.6 * SPACING, 0.1) == 4
    assert parts(1.0, 0.1, now=simulator().snapshot().contact) == 1
    whole = np.full_like(contact.slip, law.weakening_distance)
    sliding = contact._replace(slip=whole, status=np.ones_like(contact.status))
    assert parts(0.1 * SPACING, 0.2, now=sliding) == 1
    assert parts(0.0, 0.2, now=sliding) == parts(0.0, 0.2, jump=True, now=sliding) == 20
    assert parts(0.0, 0.2, now=sliding._replace(slip=1e-4 * whole)) == 1
    half = sliding._replace(slip=0.5 * whole)
    assert parts(0.1 * SPACING, 0.2, now=half) == 20
    stuck = sliding._replace(slip=0 * whole, status=np.zeros_like(contact.status))
    assert parts(0.0, 0.2, now=stuck) == 20


def test_the_opened_tissue_springs_back_in_parts(simulator):
    """Of a quarter of the 10 ms in which it yields; 32 at most."""
    sim = simulator({"tissue.damping.beta": 0.01})
    division = Division(sim.scene, sim._contact_laws)
    pose = BasePose.of(PLACE, DOWN, 2)

    def still(dt):
        return Route(PLACE, DOWN, pose, commanded(BaseCommand(), PLACE, DOWN, dt), dt)

    assert division.of_opening(still(0.02), 0.5) == 4
    assert division.of_opening(still(1.0), 1.0) == MOST
    undamped = simulator({"tissue.damping.beta": 0.0})
    assert Division(undamped.scene, undamped._contact_laws).of_opening(still(1.0), 1.0) == 1


@pytest.mark.parametrize(
    ("dynamics", "within"), [("quasi_static", 0.01), ("newmark", 0.02), ("reduced", 0.02)]
)
def test_the_path_does_not_hang_on_the_tick(coarse_scene, simulator, dynamics, within):
    """A bevelled needle driven in at 40 mm/s and held: ticks of 40 ms, 0.8 of the track's
    spacing, against 5 ms. With the path aimed at ticks' ends it was up to 14 % off."""
    found = []
    for dt in (0.04, 0.005):
        changes = {
            "needle.tip.deviation_angle": -0.3,
            "solver.dynamics": "quasi_static" if dynamics == "quasi_static" else "newmark",
            "solver.modes": 20 if dynamics == "reduced" else 0,
            "solver.time_step": dt,
        }
        sim = simulator(changes)
        for velocity, duration in (([0, 0, -40e-3], 0.8), ([0, 0, 0], 1.0)):
            for _ in range(round(duration / dt)):
                seen = sim.step(BaseCommand(velocity=velocity), dt)
        assert seen.process is Process.HOLD
        found.append(seen)
    coarse, fine = (seen.tip_deflection[0] for seen in found)
    assert abs(fine) > 2e-4
    assert coarse == pytest.approx(fine, rel=within)
    assert found[0].friction_force == pytest.approx(found[1].friction_force, rel=within)
