# SPDX-License-Identifier: Apache-2.0
"""Needle and tissue in 3D, on a mesh so coarse that it is quick."""

import math

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Scene, Simulator
from needle_sim_ros.geometry import from_rotation_vector, multiply

SCENE = {
    "name": "block",
    "dimension": 3,
    "tissue": {
        "size": [0.06, 0.06, 0.05],
        "youngs_modulus": 15e3,
        "poisson_ratio": 0.45,
        "mesh": {"spacing_across": 4e-3, "band": 8e-3, "growth": 3.0},
    },
    "needle": {
        "length": 0.08,
        "radius": 1e-3,
        "youngs_modulus": 2.1e9,
        "tip": {"bevel_angle": 0.5, "deviation_angle": 0.1},
    },
    "interaction": {
        "friction": {"static": 8.0, "kinetic": 7.0},
        "cutting": {"force": 0.2},
        "puncture": {"force": 0.3},
    },
    "markers": [[0.004, 0.002, -0.02], [-0.01, 0.012, -0.03]],
    "solver": {"track_spacing": 5e-3},
    "base": {"position": [0, 0, 0.085]},
    "protocol": [{"duration": 9.0, "velocity": [0, 0, -5e-3]}],
}
DT = 0.1
DOWN = BaseCommand(velocity=[0, 0, -5e-3])


def built(changes=None):
    return Simulator(Scene.from_dict(SCENE, changes))


def inserted(sim, ticks=90, command=DOWN):
    return [sim.step(command, DT) for _ in range(ticks)][-1]


@pytest.fixture(scope="module")
def kept():
    return built()


@pytest.fixture
def sim(kept):
    kept.reset()
    return kept


@pytest.fixture(scope="module")
def deep(kept):
    kept.reset()
    return inserted(kept)


def test_it_steers_to_base_x_and_stays_in_the_plane(deep):
    """Bevel at roll 0: towards +x; nothing moves out of the plane of symmetry."""
    assert deep.process.value == "insertion"
    assert deep.insertion_depth > 0.036
    x, y, _ = deep.tip_position
    assert x > 5e-4
    assert abs(y) < 1e-9 * x
    assert abs(deep.base_force[1]) < 1e-9 * abs(deep.base_force[0])
    assert abs(deep.base_torque[0]) < 1e-9 * abs(deep.base_torque[1])


def test_action_and_reaction(deep):
    """Forces on the tissue add up to minus the base force; base x, y, z are x, -y, -z here."""
    total = deep.contact_forces.sum(axis=0) * [1, -1, -1]
    np.testing.assert_allclose(total, -deep.base_force, atol=1e-14)
    # at its limits: friction of what is inserted, and cutting
    assert deep.tip_force == pytest.approx(0.2, rel=1e-9)
    assert deep.friction_force == pytest.approx(7.0 * deep.insertion_depth, rel=0.01)


def test_torque_of_the_contact_forces(deep):
    """The moment about the base of the forces where they act on the bent needle."""
    needle = deep.needle_points
    force = -deep.contact_forces
    # on the needle: the track points by their distance to the tip along it
    at = np.append(0.08 - deep.insertion_depth + 5e-3 * np.arange(len(force) - 1), 0.08)
    curve = np.array([np.interp(at, np.linspace(0, 0.08, 41), column) for column in needle.T]).T
    moment = np.cross(curve - deep.base_position, force).sum(axis=0) * [1, -1, -1]
    np.testing.assert_allclose(deep.base_torque, moment, atol=0.01 * np.abs(moment).max())


def test_markers_are_what_the_field_says(sim):
    """The mesh's field, and what a needle thinner than the cells does beyond it."""
    observation = inserted(sim, 60)
    where = np.array(SCENE["markers"])
    contact = sim.snapshot().contact
    beyond = contact.track.table.read_beyond_mesh(contact.forces).reshape(-1, 3)
    assert np.abs(beyond).max() > 1e-6
    np.testing.assert_allclose(
        sim.tissue_displacement(where) + beyond, observation.marker_displacements, atol=1e-12
    )
    assert np.linalg.norm(observation.marker_displacements, axis=1).min() > 1e-6
    assert np.isnan(sim.tissue_displacement([[0.0, 0.031, -0.01]])).all()


def test_the_plan_waits_for_no_solve(sim):
    inserted(sim)
    assert sim._dynamics.compliance.waits == 0


def test_determinism_and_snapshots(sim):
    """The same bits again, from the start and from a snapshot, after other motions too."""
    inserted(sim, 40)
    snapshot = sim.snapshot()
    once = inserted(sim, 20)
    inserted(sim, 5, BaseCommand(velocity=[1e-3, -2e-3, 0], angular_velocity=[0, 0, 0.3]))
    sim.restore(snapshot)
    again = inserted(sim, 20)
    sim.reset()
    anew = inserted(sim, 60)
    for other in (again, anew):
        np.testing.assert_array_equal(once.tip_position, other.tip_position)
        np.testing.assert_array_equal(once.base_force, other.base_force)
        np.testing.assert_array_equal(once.marker_positions, other.marker_positions)


@pytest.mark.parametrize("how", ["roll of the tip", "turn of the base"])
def test_a_quarter_turn_steers_to_the_other_side(deep, how):
    """Bevel a quarter turn on: base y, which is -y of the tissue. A block that is as wide as
    long gives the mirrored deflection."""
    if how == "roll of the tip":
        observation = inserted(built({"needle.tip.roll": math.pi / 2}))
        np.testing.assert_allclose(
            observation.tip_deflection[[1, 0]], deep.tip_deflection[:2], atol=1e-9
        )
    else:
        turned = multiply(
            from_rotation_vector(np.array([0, 0, -math.pi / 2])), np.array([1.0, 0, 0, 0])
        )
        observation = inserted(built({"base.orientation": turned.tolist()}))
        np.testing.assert_allclose(observation.tip_deflection, deep.tip_deflection, atol=1e-9)
        np.testing.assert_allclose(observation.base_force, deep.base_force, atol=1e-9)
    x, y, z = deep.tip_position
    np.testing.assert_allclose(observation.tip_position, [y, -x, z], atol=1e-9)


def test_turning_the_base_while_inserted_steers(sim):
    """Half a turn about the needle's axis half way: the tip turns back, the needle no longer
    deviates as far; a straight needle would not care."""
    straight_on = inserted(sim, 90).tip_position[0]
    sim.reset()
    inserted(sim, 50)
    before = sim.observe()
    for _ in range(10):
        still = sim.step(BaseCommand(angular_velocity=[0, 0, math.pi]), DT)
    # the shape in space hardly changes while the needle spins in its channel
    np.testing.assert_allclose(still.tip_position, before.tip_position, atol=2e-4)
    np.testing.assert_allclose(still.tip_deflection[:2], -before.tip_deflection[:2], atol=2e-4)
    turned_back = inserted(sim, 40).tip_position[0]
    assert turned_back < straight_on - 3e-4


def test_a_push_aside_is_felt_in_both_directions(sim):
    """Moved by the same amount along x and along y, a straight needle feels the same force."""
    straight = built({"needle.tip.deviation_angle": 0.0})
    inserted(straight, 60)
    snapshot = straight.snapshot()
    along_x = inserted(straight, 5, BaseCommand(velocity=[2e-3, 0, 0]))
    straight.restore(snapshot)
    along_y = inserted(straight, 5, BaseCommand(velocity=[0, 2e-3, 0]))
    # base y is -y of the tissue
    assert along_x.base_force[0] < -1e-3
    assert along_y.base_force[1] == pytest.approx(-along_x.base_force[0], rel=1e-6)
    assert abs(along_x.base_force[1]) < 1e-6 * abs(along_x.base_force[0])


def test_a_layer_gives_the_step_of_fig_3():
    """Below 17.5 mm it cuts at twice the force and rubs at twice the friction: the force rises by
    the cutting's step where the tip crosses the interface, and then twice as fast.

    The interface is midway between two track points, where hats share friction rightly."""
    layer = {
        "name": "layer",
        "shape": "half_space",
        "center": [0, 0, -0.0175],
        "youngs_modulus": 30e3,
        "friction_static": 14.0,
        "friction_kinetic": 14.0,
        "cutting_force": 0.4,
    }
    other = built({"tissue.regions": [layer], "needle.tip.deviation_angle": 0.0})
    depth, force = [], []
    for _ in range(90):
        observation = other.step(DOWN, DT)
        depth.append(observation.insertion_depth)
        force.append(-observation.base_force[2])
    depth, force = np.array(depth), np.array(force)
    above = (depth > 8e-3) & (depth < 0.0145)  # the needle snaps in by 6.8 mm
    below = (depth > 0.025) & (depth < 0.038)
    slope_above, offset_above = np.polyfit(depth[above], force[above], 1)
    slope_below, offset_below = np.polyfit(depth[below], force[below], 1)
    assert slope_above == pytest.approx(7.0, rel=0.05)
    assert slope_below == pytest.approx(14.0, rel=0.05)
    step = (slope_below - slope_above) * 0.0175 + offset_below - offset_above
    assert step == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("dynamics", [{"solver.modes": 0}, {"solver.modes": 8}])
def test_newmark_held_long_is_quasi_static(deep, dynamics):
    """Slowly driven, the dynamic tissue gives nearly what the massless one does."""
    changes = {"solver.dynamics": "newmark", "solver.time_step": DT, **dynamics}
    changes["tissue.damping"] = {"alpha": 0.0, "beta": 5e-3}
    observation = inserted(built(changes))
    np.testing.assert_allclose(observation.base_force, deep.base_force, rtol=0.02, atol=2e-4)
    np.testing.assert_allclose(observation.tip_position, deep.tip_position, atol=5e-5)
