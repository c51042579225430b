# SPDX-License-Identifier: Apache-2.0
"""Lateral forces: inclined contact (Eqs. 9 to 12), bevel deviation, steering by the base."""

import math

import numpy as np
import pytest
import scipy.sparse as sp

from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.tissue.model import TissueModel

STRAIGHT = {"needle.tip.deviation_angle": 0.0}
DOWN = (0, 0, -3e-3)
LENGTH, RIGIDITY = 0.13, 2.1e9 * 0.7854e-12


def inclined(angle):
    """Needle turned by an angle about y, its tip 2 mm before the origin, 22 mm in."""
    direction = np.array([-math.sin(angle), 0.0, -math.cos(angle)])
    half = angle / 2
    return {
        "base.position": (-(LENGTH + 2e-3) * direction).tolist(),
        # the base points down after half a turn about x, then leans
        "base.orientation": [math.cos(half), 0.0, -math.sin(half), 0.0],
        "protocol": [{"duration": 8.0, "velocity": (3e-3 * direction).tolist()}],
    }, direction


def pressed_compliance(scene, direction):
    """Displacement (2, 2) of the cross-section at the origin per force on it, direct solve."""
    model = TissueModel(scene)
    footprint = Coupling(model, scene.needle.radius).section(np.zeros(2), direction)
    loads = np.zeros((model.nodes, 2, 2))
    for axis in (0, 1):
        loads[footprint.nodes, axis, axis] = footprint.weights
    loads = loads.reshape(-1, 2)[model.free]
    return loads.T @ sp.linalg.spsolve(sp.csc_matrix(model.stiffness), loads)


@pytest.mark.parametrize("angle", [0.35, -0.2])
def test_inclined_contact_is_state_3_of_the_spring_model(coarse_scene, simulator, drive, angle):
    """Eqs. (9) to (11): with the needle straight (state 1) the tissue pushes it sideways by
    F1; bent by F1 / K1 (state 2) the unbalance is F2; the secant through both gives the
    equilibrium deflection y3. The tissue's force follows from its own compliance at the
    entry, in axes turned as Eq. (12) does."""
    changes, direction = inclined(angle)
    scene = coarse_scene({**STRAIGHT, **changes})
    axial = direction[[0, 2]]
    lateral = np.array([math.cos(angle), -math.sin(angle)])  # base x
    axes = np.array([lateral, axial])
    stiffness = np.linalg.inv(axes @ pressed_compliance(scene, axial) @ axes.T)
    needle_stiffness = 3 * RIGIDITY / LENGTH**3  # K1

    o = drive(simulator({**STRAIGHT, **changes}), 1.0, 3e-3 * direction)[-1]
    assert o.process is Process.CONTACT
    advance = 1e-3  # 3 mm travelled, 2 mm of them in the air

    def sideways_on_needle(deflection):
        return -(stiffness @ np.array([deflection, advance]))[0]

    f1 = sideways_on_needle(0.0)
    y2 = f1 / needle_stiffness
    f2 = sideways_on_needle(y2) - f1
    y3 = -f1 * y2 / (f2 - f1)
    assert abs(y3) > 1e-6
    np.testing.assert_allclose(o.tip_deflection, [y3, 0, 0], rtol=1e-8, atol=1e-15)
    axial_force = (stiffness @ np.array([y3, advance]))[1]
    assert o.tip_force == pytest.approx(axial_force, rel=1e-8)
    assert o.base_force == pytest.approx([needle_stiffness * y3, 0, -axial_force], rel=1e-8)
    assert o.base_torque[1] == pytest.approx(
        LENGTH * needle_stiffness * y3 - (-axial_force) * y3, rel=1e-8
    )


def mirrored(vectors):
    return np.asarray(vectors) * np.array([-1, 1, 1])


def assert_mirror(one, other, tolerance=1e-9):
    """The same in a mirror x -> -x: in the tissue frame x changes sign, in the base frame
    the deflection, the lateral force and the torque about y."""
    assert one.process is other.process
    assert other.insertion_depth == pytest.approx(one.insertion_depth, abs=tolerance)
    np.testing.assert_allclose(other.tip_position, mirrored(one.tip_position), atol=tolerance)
    np.testing.assert_allclose(other.tip_deflection, mirrored(one.tip_deflection), atol=tolerance)
    np.testing.assert_allclose(other.base_force, mirrored(one.base_force), atol=1e3 * tolerance)
    np.testing.assert_allclose(
        other.base_torque, -mirrored(one.base_torque) * [1, 1, 0], atol=1e2 * tolerance
    )
    np.testing.assert_allclose(other.contact_points, mirrored(one.contact_points), atol=tolerance)


def test_inclinations_mirror_each_other(simulator, drive):
    """theta and -theta, with the bevel turned round, through contact, insertion, retraction."""
    runs = []
    for angle, roll in ((0.3, 0.0), (-0.3, math.pi)):
        changes, direction = inclined(angle)
        sim = simulator({**changes, "needle.tip.roll": roll})
        runs.append(drive(sim, 8.0, 3e-3 * direction) + drive(sim, 3.0, -3e-3 * direction))
    for one, other in zip(*runs, strict=True):
        assert_mirror(one, other)
    deepest = runs[0][159]
    assert deepest.insertion_depth > 0.019
    # the surface lies aslant: the needle bends
    assert abs(deepest.tip_deflection[0]) > 1e-5


def test_an_inclined_needle_follows_its_line(simulator, drive):
    """Without deviation the tip stays within 1 mm of the straight line, whatever its slope."""
    changes, direction = inclined(0.3)
    sim = simulator({**STRAIGHT, **changes})
    o = drive(sim, 8.0, 3e-3 * direction)[-1]
    normal = np.array([direction[2], 0.0, -direction[0]])
    for point in (*o.contact_points, o.tip_position):
        assert abs(point @ normal) < 1e-3
    assert o.insertion_depth > 0.019


def test_the_vertical_straight_needle_stays_straight(simulator, drive):
    """Symmetry: no lateral force, no deflection, no torque."""
    for o in drive(simulator(STRAIGHT), 12.0, DOWN):
        assert abs(o.tip_deflection[0]) < 1e-12
        assert abs(o.base_force[0]) < 1e-10 and abs(o.base_torque[1]) < 1e-11


def test_the_bevel_steers_to_its_side(simulator, drive):
    """Roll 0 towards +x of the base, which is +x of the tissue here; roll pi its mirror."""
    ends = []
    for roll in (0.0, math.pi):
        sim = simulator({"needle.tip.deviation_angle": 0.1, "needle.tip.roll": roll})
        ends.append(drive(sim, 15.0, DOWN))
    for one, other in zip(*ends, strict=True):
        assert_mirror(one, other)
    last = ends[0][-1]
    assert last.tip_position[0] > 1e-3 and last.tip_deflection[0] > 1e-3
    # the tissue holds it back
    assert last.base_force[0] < -1e-3
    # and the track bends ever further to that side
    x = last.contact_points[:-1, 0]
    assert (np.diff(x) > 0).all()


def test_half_way_between_the_bevel_does_not_steer_in_the_plane(simulator, drive):
    sim = simulator({"needle.tip.deviation_angle": 0.1, "needle.tip.roll": math.pi / 2})
    assert abs(drive(sim, 12.0, DOWN)[-1].tip_position[0]) < 1e-9


def test_a_greater_deviation_steers_further(simulator, drive):
    """Small angles: in proportion."""
    ends = [
        drive(simulator({"needle.tip.deviation_angle": angle}), 15.0, DOWN)[-1].tip_position[0]
        for angle in (0.02, 0.04)
    ]
    assert ends[1] / ends[0] == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_moving_the_base_aside_turns_the_needle_about_the_tissue(simulator, drive, side):
    """With 25 mm in, the base goes 4 mm aside: the entry is carried along, the tip's slope
    leans the other way, the tissue pulls back, and a mirror image gives the mirror."""
    sim = simulator(STRAIGHT)
    drive(sim, 35e-3 / 3e-3, DOWN)
    o = drive(sim, 2.0, (side * 2e-3, 0, 0))[-1]
    assert o.base_position[0] == pytest.approx(side * 4e-3, rel=1e-9)
    assert side * o.tip_deflection[0] < -1e-3
    assert side * o.base_force[0] < 0  # what the tissue does to the needle
    at_entry = sim.tissue_displacement(o.contact_points[:1])[0]
    assert side * at_entry[0] > 1e-4
    sim = simulator(STRAIGHT)
    drive(sim, 35e-3 / 3e-3, DOWN)
    assert_mirror(o, drive(sim, 2.0, (-side * 2e-3, 0, 0))[-1])


def test_the_moved_base_steers_what_follows(simulator, drive):
    """A lever about the entry: pushing on after moving the base to +x the needle cuts to -x,
    while the track laid before stays straight."""
    sim = simulator(STRAIGHT)
    drive(sim, 35e-3 / 3e-3, DOWN)
    drive(sim, 2.0, (3e-3, 0, 0))
    o = drive(sim, 5.0, DOWN)[-1]
    x = o.contact_points[:, 0]
    old = o.contact_points[:, 2] > -0.02
    assert np.abs(x[old]).max() < 1e-9
    assert x[-1] < -3e-4 and (np.diff(x[~old]) < 1e-12).all()


@pytest.mark.parametrize("turn", [0.02, -0.02])
@pytest.mark.parametrize(("modulus", "side"), [(2.1e9, 1.0), (2.1e13, -1.0)])
def test_turning_the_base_steers(simulator, drive, turn, modulus, side):
    """A turn about +y takes the free end of a needle that points down towards -x. A rigid
    needle cuts there. A flexible one is propped by the tissue: a beam that is turned at its
    clamp by a carries over -a/2 to its propped end, and cuts to +x."""
    sim = simulator({**STRAIGHT, "needle.youngs_modulus": modulus})
    drive(sim, 30e-3 / 3e-3, DOWN)
    o = drive(sim, 2.0, turn=turn)[-1]
    direction = (-3e-3 * math.sin(2 * turn), 0, -3e-3 * math.cos(2 * turn))
    assert -o.base_torque[1] * turn < 0  # turned back; base y is -y of the tissue
    on = drive(sim, 5.0, direction)[-1]
    assert math.copysign(1, turn) * side * on.contact_points[-1, 0] > 1e-4


def test_lateral_motion_is_elastic(simulator, drive):
    """Out and back by the base, in a hold with friction and cutting off: all as before."""
    none = {"friction": {"static": 0.0, "kinetic": 0.0}, "cutting": {"force": 0.0}}
    sim = simulator({**STRAIGHT, "interaction": none})
    drive(sim, 35e-3 / 3e-3, DOWN)
    before = drive(sim, 0.5)[-1]
    aside = drive(sim, 1.0, (3e-3, 0, 0))[-1]
    after = drive(sim, 1.0, (-3e-3, 0, 0))[-1]
    assert abs(aside.base_force[0]) > 1e-2
    assert abs(after.base_force[0]) < 1e-3 * abs(aside.base_force[0])
    np.testing.assert_allclose(after.tip_position, before.tip_position, atol=1e-5)


def test_a_stiff_needle_pushes_the_tissue_aside(simulator, drive):
    """Lateral stiffness between needle and tissue: the stiffer the needle, the less it bends
    and the further the tissue goes; in the limit the needle stays straight."""
    entries, bends = [], []
    for modulus in (2.1e9, 2.1e11, 2.1e14):
        sim = simulator({**STRAIGHT, "needle.youngs_modulus": modulus})
        drive(sim, 35e-3 / 3e-3, DOWN)
        o = drive(sim, 1.0, (2e-3, 0, 0))[-1]
        entries.append(sim.tissue_displacement(o.contact_points[:1])[0, 0])
        bends.append(abs(o.tip_deflection[0]))
    assert entries[0] < entries[1] < entries[2] == pytest.approx(2e-3, rel=0.05)
    assert bends[0] > bends[1] > 1e2 * bends[2]
