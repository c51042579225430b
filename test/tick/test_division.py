# SPDX-License-Identifier: Apache-2.0
"""A tick in parts: the way, where it is divided, and what does not hang on the division."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from needle_sim_ros.substeps import FreeOnTheWay, Reach, Route, caught, ends, parts_of_step

from needle_sim_ros import BaseCommand, CommandError
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.interaction.state import AIMED, ContactState
from needle_sim_ros.tick.base_motion import commanded

PLACE = np.array([0.01, 0.0, 0.14])
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
SPACING = 2e-3  # of the coarse scene


def route(**command):
    pose = BasePose.of(PLACE, DOWN, 2)
    return Route(PLACE, DOWN, pose, commanded(BaseCommand(**command), PLACE, DOWN, 0.1))


@given(st.floats(0.0, 1.0))
def test_a_straight_way_in_proportion(share):
    way = route(velocity=(0.03, 0.0, -0.04))
    assert way.length == pytest.approx(5e-3)
    assert way.advance == pytest.approx(4e-3)
    np.testing.assert_allclose(way.at(share).origin, [0.01 + 3e-3 * share, 0.14 - 4e-3 * share])


@given(st.floats(0.0, 1.0))
def test_a_turn_in_proportion(share):
    axial = route(angular_velocity=(0.0, 2.0, 0.0)).at(share).axial
    np.testing.assert_allclose(np.arctan2(-axial[0], -axial[1]), 0.2 * share, atol=1e-12)


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


def test_a_turn_sweeps_the_needle():
    assert route(angular_velocity=(0.0, 2.0, 0.0)).swept(0.1) == pytest.approx(0.02)
    assert route(velocity=(0.03, 0.0, -0.04)).swept(0.1) == pytest.approx(5e-3)


def test_what_the_needle_dragged_goes_on_when_it_stops():
    pose = BasePose.of(PLACE, DOWN, 2)
    rest = commanded(BaseCommand(), PLACE, DOWN, 0.1)
    assert Route(PLACE, DOWN, pose, rest, (0, 0, -0.05, 0, 0, 0)).fastest(0.1) == 0.05
    assert Route(PLACE, DOWN, pose, rest).fastest(0.1) == 0.0


def test_a_step_of_the_tissue_falls_in_parts(simulator):
    """Of half a track spacing; of a tenth of the healing time while friction recovers."""
    scene = simulator().scene
    law, contact = scene.interaction.friction, inserted(simulator())

    def parts(way, dt, jump=False, now=contact):
        pose = BasePose.of(PLACE, DOWN, 2)
        moved = commanded(BaseCommand(velocity=(0, 0, -way / dt)), PLACE, DOWN, dt)
        return parts_of_step(scene, law, now, Route(PLACE, DOWN, pose, moved), 1.0, dt, jump)

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


def test_free_displacement_starts_where_the_tissue_is(simulator):
    """At the start of a step it is what the forces of then leave of the displacement."""
    sim = simulator({"solver.dynamics": "newmark", "solver.time_step": 0.05, "solver.modes": 20})
    contact = inserted(sim)
    table = contact.track.table
    rows = np.full_like(contact.moved, 1e-3)
    free = FreeOnTheWay(lambda _: rows.copy(), contact)
    forced = table.displacement(contact.forces)
    np.testing.assert_allclose(free.at(0.0)(table) + forced, contact.moved, atol=1e-15)
    np.testing.assert_array_equal(free.at(1.0)(table), rows)


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
