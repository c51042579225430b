# SPDX-License-Identifier: Apache-2.0
"""The tissue on the way through a time step."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand
from needle_sim_ros.tick.on_the_way import OnTheWay

NEWMARK = {
    "solver.dynamics": "newmark",
    "solver.time_step": 0.05,
    "solver.modes": 20,
    "tissue.damping.beta": 0.01,
}


def begun(simulator):
    sim = simulator(NEWMARK)
    for _ in range(100):
        sim.step(BaseCommand(velocity=[0, 0, -3e-3]), 0.05)
    return sim.snapshot().contact


@pytest.mark.parametrize("viscosity", [0.0, 0.01])
def test_it_starts_where_the_tissue_is(simulator, viscosity):
    """At the start of a step it is what the forces of then leave of the displacement."""
    contact = begun(simulator)
    table = contact.track.table
    rows = np.full_like(contact.moved, 1e-3)
    way = OnTheWay(lambda _: rows.copy(), contact, viscosity, 0.05, contact.forces, False)
    yielded, free = way.at(1e-12)
    forced = table.displacement(yielded.part * contact.forces)
    np.testing.assert_allclose(free(table) + forced, contact.moved, atol=1e-14)


def test_even_forces_move_it_evenly(simulator):
    """Whatever the viscosity: half of the way after half of the step."""
    contact = begun(simulator)
    table = contact.track.table
    rows, onward = np.full_like(contact.moved, 1e-3), 1.5 * contact.forces
    way = OnTheWay(lambda _: rows.copy(), contact, 0.01, 0.05, onward, False)
    end = rows + table.displacement(onward)
    for share in (0.2, 0.5, 0.9):
        yielded, free = way.at(share)
        forces = contact.forces + share * (onward - contact.forces)
        moved = free(table) + table.displacement(yielded.part * forces)
        np.testing.assert_allclose(moved, (1 - share) * contact.moved + share * end, atol=1e-13)
        way.took(share, contact._replace(forces=forces))


def test_what_jumps_is_met_by_a_part_of_the_compliance(simulator):
    """Little of it at once, all of it without viscosity."""
    contact = begun(simulator)
    forces = contact.forces
    parts = [
        OnTheWay(lambda _: contact.moved.copy(), contact, v, 0.05, forces, False).at(0.01)[0].part
        for v in (0.0, 0.01)
    ]
    assert parts[0] == 1.0
    assert 0.0 < parts[1] < 0.1
