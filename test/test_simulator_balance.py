# SPDX-License-Identifier: Apache-2.0
"""Action and reaction, and equilibrium of needle and tissue, at every tick."""

import math

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Simulator
from needle_sim_ros.geometry import rotation_matrix
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.needle.beam import flexibility

LENGTH, RIGIDITY, SPACING = 0.13, 2.1e9 * 0.7854e-12, 2e-3

# twists (m/s, rad/s) and how long they last: in, aside, turning, out and in again, out
MANOEUVRE = [
    ((0, 0, -3e-3), 0.0, 8.0),
    ((1.5e-3, 0, -2e-3), 0.0, 2.0),
    ((0, 0, 0), 0.02, 2.0),
    ((-2e-3, 0, -2e-3), -0.03, 2.0),
    ((0, 0, 0), 0.0, 1.0),
    ((0, 0, 4e-3), 0.0, 1.5),
    ((0, 0, -4e-3), 0.0, 2.5),
    ((1e-3, 0, 5e-3), 0.01, 6.0),
]
WAYS = {
    "quasi_static": {"needle.tip.deviation_angle": 0.1},
    "reduced": {
        "solver.dynamics": "newmark",
        "solver.modes": 20,
        "needle.tip.deviation_angle": 0.1,
    },
    "newmark": {"solver.dynamics": "newmark", "solver.time_step": 0.05},
    "stiff": {"needle.youngs_modulus": 2.1e11, "needle.tip.deviation_angle": 0.05},
    "hard": {"tissue.youngs_modulus": 3e5, "needle.tip.roll": math.pi},
}


@pytest.fixture(scope="module", params=WAYS)
def run(request, coarse_scene, drive):
    """The manoeuvre, as (simulator, observations)."""
    sim = Simulator(coarse_scene(WAYS[request.param]))
    observations = []
    for velocity, turn, duration in MANOEUVRE:
        observations += drive(sim, duration, velocity, turn)
    assert {o.process for o in observations} >= set(Process) - {Process.HOLD}
    return sim, observations


def in_base(o, vectors):
    """Turn vectors (n, 3) of the tissue frame into the base frame."""
    return np.asarray(vectors) @ rotation_matrix(o.base_orientation)


def test_forces_add_up_to_minus_the_base_force(run):
    """To 1e-9 of the run's largest force, every tick, every component."""
    _, observations = run
    peak = max(np.abs(o.base_force).max() for o in observations)
    assert peak > 0.5
    for o in observations:
        total = in_base(o, o.contact_forces).sum(axis=0)
        np.testing.assert_allclose(total, -o.base_force, atol=1e-9 * peak)


def test_axial_force_is_friction_and_tip(run):
    _, observations = run
    for o in observations:
        assert -o.base_force[2] == pytest.approx(o.friction_force + o.tip_force, abs=1e-12)


def on_needle(o):
    """Arclengths of the contact points, the tip last: from the entry a spacing apart."""
    at = o._contact.arclength
    np.testing.assert_allclose(np.diff(at), SPACING, rtol=1e-9)
    if o.process is Process.CONTACT:
        return at
    # the depth reported is one correction newer than the forces
    assert LENGTH - at[0] == pytest.approx(o.insertion_depth, abs=0.021 * SPACING)
    return np.append(at, LENGTH)


def test_the_needle_is_the_bent_cantilever(run):
    """Deflection of the tip by the beam's flexibility from the lateral forces alone."""
    _, observations = run
    for o in observations:
        if len(o.contact_forces) == 0:
            assert not o.tip_deflection.any()
            continue
        lateral = -in_base(o, o.contact_forces)[:, 0]
        bent = flexibility(np.array([LENGTH]), on_needle(o), RIGIDITY * _stiffness(o))
        assert o.tip_deflection[0] == pytest.approx(float(bent[0] @ lateral), rel=1e-9, abs=1e-13)


def _stiffness(o):
    return o._scene.needle.youngs_modulus / 2.1e9


def test_moments_add_up_to_the_base_torque(run):
    """r x F about the clamp, r the deflected needle at each contact point."""
    _, observations = run
    largest = max(np.abs(o.base_torque).max() for o in observations)
    assert largest > 1e-4
    for o in observations:
        if len(o.contact_forces) == 0:
            assert not o.base_torque.any()
            continue
        at, forces = on_needle(o), -in_base(o, o.contact_forces)
        bent = flexibility(at, at, RIGIDITY * _stiffness(o)) @ forces[:, 0]
        arms = np.column_stack([bent, np.zeros(len(at)), at])
        torque = np.cross(arms, forces).sum(axis=0)
        np.testing.assert_allclose(o.base_torque, torque, atol=1e-9 * largest)


def test_friction_and_tip_stay_within_their_limits(run):
    """|f_k| <= 16 N/m times the length of its hat, 0 <= tip <= puncture force."""
    _, observations = run
    for o in observations:
        assert 0 <= o.tip_force <= 0.5 + 1e-9
        if o.process in (Process.FREE, Process.CONTACT):
            continue
        axial = in_base(o, o.contact_forces)[:-1, 2]
        assert np.abs(axial).max(initial=0) <= 16.0 * SPACING * (1 + 1e-9)
        assert abs(o.friction_force) <= 16.0 * o.insertion_depth + 1e-3


def test_equilibrium_is_reported(run):
    sim, _ = run
    assert sim.statistics.worst_residual < 1e-8


def test_the_needle_lies_in_its_channel(coarse_scene, simulator, drive):
    """The track points, displaced by the tissue's own full field (a separate solve of all
    unknowns, averaged over the needle's width), lie on the deflected needle."""
    sim = simulator({"needle.tip.deviation_angle": 0.1})
    drive(sim, 12.0, (0, 0, -3e-3))
    o = drive(sim, 1.0, (2e-3, 0, 0))[-1]
    points = o.contact_points[1:-4]
    inner = 1e-3 * np.polynomial.legendre.leggauss(5)[0]
    share = np.polynomial.legendre.leggauss(5)[1] / 2
    chord = points[:, None, :] + inner[None, :, None] * np.array([1.0, 0.0, 0.0])
    moved = sim.tissue_displacement(chord.reshape(-1, 3)).reshape(len(points), 5, 3)
    now = points + share @ moved
    at = on_needle(o)
    lateral = -in_base(o, o.contact_forces)[:, 0]
    bent = flexibility(at[1:-4], at, RIGIDITY) @ lateral
    straight = o.base_position[0]
    np.testing.assert_allclose(now[:, 0], straight + bent, atol=3e-5)
    assert np.abs(now[:, 0] - points[:, 0]).max() > 3e-4


def test_still_air(simulator):
    """A needle that never touches anything carries nothing, whatever it does."""
    sim = simulator()
    o = sim.step(BaseCommand(velocity=[1e-2, 0, 1e-2], angular_velocity=[0, 0.1, 0]), 0.5)
    assert not o.base_force.any() and not o.base_torque.any() and not o.tip_deflection.any()
    assert o.process is Process.FREE
