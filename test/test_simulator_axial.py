# SPDX-License-Identifier: Apache-2.0
"""The axial force of a vertical needle, segment by segment of Fig. 3, against the laws."""

import math

import numpy as np
import pytest
import scipy.sparse as sp

from needle_sim_ros import Simulator
from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.tissue.model import TissueModel

STRAIGHT = {"needle.tip.deviation_angle": 0.0}
KINETIC, STATIC, CUTTING, PUNCTURE, RELAXATION = 14.0, 16.0, 0.3, 0.5, 1.5
DOWN, UP = (0, 0, -3e-3), (0, 0, 3e-3)
BEVEL = 2e-3 / math.tan(math.radians(20))
# the depth of a tick is found to within this part of the track spacing of 2 mm
DEPTH_TOLERANCE = 0.02 * 2e-3


def pressed_compliance(scene, direction=(0.0, -1.0)):
    """Displacement (2, 2) of the needle's cross-section at the origin per force on it: one
    sparse solve of the whole tissue, by scipy's other solver."""
    model = TissueModel(scene)
    footprint = Coupling(model, scene.needle.radius).section(np.zeros(2), np.array(direction))
    loads = np.zeros((model.nodes, 2, 2))
    for axis in (0, 1):
        loads[footprint.nodes, axis, axis] = footprint.weights
    loads = loads.reshape(-1, 2)[model.free]
    answers = sp.linalg.spsolve(sp.csc_matrix(model.stiffness), loads)
    return loads.T @ answers


def of(observations, process):
    return [o for o in observations if o.process is process]


def test_the_processes_follow_each_other(protocol):
    """Free, contact, insertion; hold; retraction, free: never back, nothing else."""
    names = [o.process.value for part in ("in", "hold", "out") for o in protocol[part]]
    runs = [name for name, before in zip(names, [None, *names], strict=False) if name != before]
    assert runs == ["free", "contact", "insertion", "hold", "retraction", "free"]


def test_nothing_happens_above_the_surface(protocol):
    free = of(protocol["in"], Process.FREE)
    assert len(free) == 66  # 10 mm at 3 mm/s take 3.33 s
    for o in free:
        assert not o.base_force.any() and not o.tip_deflection.any() and o.insertion_depth == 0
        assert len(o.contact_points) == len(o.contact_forces) == 0


def test_contact_is_a_linear_spring(protocol, coarse_scene):
    """Before the puncture: the indentation over the tissue's own compliance at the entry."""
    stiffness = 1 / pressed_compliance(coarse_scene(STRAIGHT))[1, 1]
    contact = of(protocol["in"], Process.CONTACT)
    assert len(contact) > 10
    for o in contact:
        indentation = -o.tip_position[2]
        assert o.tip_force == pytest.approx(stiffness * indentation, rel=1e-9)
        assert o.base_force[2] == pytest.approx(-o.tip_force, rel=1e-12)
        assert o.insertion_depth == 0 and o.friction_force == 0


def test_the_surface_breaks_at_the_puncture_force(protocol):
    """The last contact is within one tick's rise of the limit; then the needle is in."""
    forces = [o.tip_force for o in of(protocol["in"], Process.CONTACT)]
    rise = forces[-1] - forces[-2]
    assert PUNCTURE - rise < forces[-1] <= PUNCTURE
    (first, *_) = of(protocol["in"], Process.INSERTION)
    assert first.insertion_depth > 0


def test_the_puncture_force_falls_to_the_cutting_force_over_the_bevel(protocol):
    """Linear in the depth: 0.5 - 0.2 depth / bevel length, then 0.3 N."""
    for o in of(protocol["in"], Process.INSERTION):
        expected = CUTTING + (PUNCTURE - CUTTING) * max(0.0, 1 - o.insertion_depth / BEVEL)
        slack = (PUNCTURE - CUTTING) * DEPTH_TOLERANCE / BEVEL
        assert o.tip_force == pytest.approx(expected, abs=2 * slack)


def test_sliding_friction_is_the_kinetic_limit_times_the_depth(protocol):
    """Once the first half millimetre has slipped; Fig. 3's straight rise with the depth."""
    deep = [o for o in of(protocol["in"], Process.INSERTION) if o.insertion_depth > 6e-3]
    assert deep[-1].insertion_depth > 0.035
    for o in deep:
        assert o.friction_force == pytest.approx(
            KINETIC * o.insertion_depth, abs=2 * KINETIC * DEPTH_TOLERANCE
        )
        assert -o.base_force[2] == pytest.approx(o.friction_force + o.tip_force, rel=1e-12)


def test_the_depth_is_what_the_base_pushed_less_what_the_tissue_gave(coarse_scene, drive):
    """Depth along the track = depth of the tip + upward displacement of the tissue there,
    which is sampled from the full field on both sides of the needle."""
    sim = Simulator(coarse_scene(STRAIGHT))
    o = drive(sim, 14.0, DOWN)[-1]
    assert o.tip_position[2] == pytest.approx(-0.032, abs=1e-12)
    over = np.linspace(-1e-3, 1e-3, 9)
    height = -o.insertion_depth + np.linspace(0, BEVEL, 9)
    places = np.array([[x, 0.0, z] for x in over for z in height])
    given = sim.tissue_displacement(places)[:, 2].mean()
    assert -1.5e-3 < given < -0.3e-3
    assert o.insertion_depth == pytest.approx(0.032 + given, abs=5e-5)


def test_the_tip_force_relaxes_in_a_hold(protocol):
    """exp(-t / T) from t1 on, exactly; friction stays within its limits (t1 to t2)."""
    start = protocol["in"][-1].tip_force
    for n, o in enumerate(protocol["hold"], 1):
        assert o.tip_force == pytest.approx(start * math.exp(-0.05 * n / RELAXATION), rel=1e-9)
        assert abs(o.friction_force) <= STATIC * o.insertion_depth * 1.01


def test_the_needle_springs_on_in_a_hold(protocol):
    """As the tip lets go, the compressed tissue comes back over the needle: depth grows a
    little, the base force falls by less than the tip's."""
    before, after = protocol["in"][-1], protocol["hold"][-1]
    assert 0 < after.insertion_depth - before.insertion_depth < 1e-3
    fall = after.base_force[2] - before.base_force[2]
    assert 0 < fall <= before.tip_force - after.tip_force + 1e-12


def test_retraction_changes_the_sign_and_decays(protocol):
    """The tissue pulls on the needle: kinetic friction times depth, no tip force, then free."""
    out = of(protocol["out"], Process.RETRACTION)
    sliding = [o for o in out if o.insertion_depth < 0.034]
    for o in sliding:
        assert o.tip_force == 0
        assert o.base_force[2] == pytest.approx(
            KINETIC * o.insertion_depth, abs=2 * KINETIC * DEPTH_TOLERANCE
        )
    forces = np.array([o.base_force[2] for o in sliding])
    assert (np.diff(forces) < 0).all()
    last = protocol["out"][-1]
    assert last.process is Process.FREE and not last.base_force.any()
    assert last.insertion_depth == 0


def test_static_friction_shows_at_the_start_of_a_retraction(simulator, drive):
    """In stiff tissue all points let go at once: the peak is 16 N/m times the depth, and
    after half a millimetre of slip 14 N/m (segments DE and FG of Fig. 3)."""
    stiff = {**STRAIGHT, "tissue.youngs_modulus": 5e6, "interaction.friction.static": 28.0}
    sim = simulator(stiff)
    drive(sim, 10.0, DOWN)
    drive(sim, 10.0)
    out = drive(sim, 0.6, UP, dt=2e-3)
    ratio = np.array([o.base_force[2] / o.insertion_depth for o in out])
    assert ratio.max() == pytest.approx(28.0, rel=0.01)
    assert ratio[-1] == pytest.approx(KINETIC, rel=0.01)
    # between them it falls linearly with the slip since it let go, over 0.5 mm
    peak = int(ratio.argmax())
    slipped = 3e-3 * 2e-3 * (np.arange(len(out)) - peak)
    falling = (slipped > 0) & (slipped < 4.5e-4)
    np.testing.assert_allclose(
        ratio[falling], 28.0 - 14.0 * slipped[falling] / 5e-4, rtol=0, atol=0.7
    )


def test_the_old_channel_is_entered_without_cutting(simulator, drive):
    """In again at the same place: friction alone, until the tip comes to the channel's end."""
    sim = simulator(STRAIGHT)
    first = drive(sim, 10.0, DOWN)
    front = first[-1].insertion_depth
    drive(sim, 10.0, UP)
    assert sim.observe().process is Process.FREE
    again = drive(sim, 13.0, DOWN)
    assert not of(again, Process.CONTACT)
    inside = [o for o in again if 6e-3 < o.insertion_depth < front - 1e-3]
    assert len(inside) > 50
    for o in inside:
        assert o.tip_force == 0
        assert o.friction_force == pytest.approx(
            KINETIC * o.insertion_depth, abs=2 * KINETIC * DEPTH_TOLERANCE
        )
    beyond = [o for o in again if o.insertion_depth > front + 1e-3]
    assert len(beyond) > 50
    assert all(o.tip_force == pytest.approx(CUTTING, rel=1e-12) for o in beyond)


def test_pulling_back_a_little_and_pushing_on(simulator, drive):
    """Within the channel no cutting; on coming to its end the cutting force is back."""
    sim = simulator(STRAIGHT)
    drive(sim, 12.0, DOWN)
    front = sim.observe().insertion_depth
    drive(sim, 3.0, UP)
    assert sim.observe().insertion_depth < front - 5e-3
    on = drive(sim, 5.0, DOWN)
    for o in on:
        if o.insertion_depth < front - 1e-3:
            assert o.tip_force == 0
        elif o.insertion_depth > front + 1e-3:
            assert o.tip_force == pytest.approx(CUTTING, rel=1e-12)
    assert on[-1].insertion_depth > front + 2e-3


def test_beside_the_old_channel_the_surface_has_to_be_broken_again(simulator, drive):
    """More than a radius aside."""
    sim = simulator(STRAIGHT)
    drive(sim, 8.0, DOWN)
    drive(sim, 8.0, UP)
    drive(sim, 1.0, (3e-3, 0, 0))
    again = drive(sim, 6.0, DOWN)
    forces = [o.tip_force for o in of(again, Process.CONTACT)]
    assert max(forces) > 0.9 * PUNCTURE


def test_cutting_ripples_along_the_depth(simulator, drive):
    """Line AB: 0.3 (1 + 0.2 sin 2 pi d / 20 mm), a wave so long that the tip never sticks."""
    ripple = {"amplitude": 0.2, "wavelength": 20e-3}
    sim = simulator({**STRAIGHT, "interaction.cutting.ripple": ripple})
    ticks = [o for o in drive(sim, 14.0, DOWN) if o.insertion_depth > BEVEL]
    depths = np.array([o.insertion_depth for o in ticks])
    forces = np.array([o.tip_force for o in ticks])
    expected = CUTTING * (1 + 0.2 * np.sin(2 * math.pi * depths / 20e-3))
    steepest = CUTTING * 0.2 * 2 * math.pi / 20e-3
    np.testing.assert_allclose(forces, expected, atol=1.01 * steepest * DEPTH_TOLERANCE)
    assert np.ptp(forces) > 0.39 * CUTTING


def test_a_short_ripple_makes_the_tip_stick_and_slip(simulator, drive):
    """Where the limit rises faster than the tissue loads the tip waits below it."""
    ripple = {"amplitude": 0.5, "wavelength": 2e-3}
    sim = simulator({**STRAIGHT, "interaction.cutting.ripple": ripple})
    ticks = [o for o in drive(sim, 12.0, DOWN) if o.insertion_depth > BEVEL]
    steepest = CUTTING * 0.5 * 2 * math.pi / 2e-3
    for o in ticks:
        limit = CUTTING * (1 + 0.5 * math.sin(2 * math.pi * o.insertion_depth / 2e-3))
        assert 0 <= o.tip_force <= limit + 1.01 * steepest * DEPTH_TOLERANCE
    steps = np.diff([o.insertion_depth for o in ticks])
    assert steps.min() < 0.5 * 1.5e-4 and steps.max() > 3 * 1.5e-4


def test_the_tip_waits_at_a_harder_layer(simulator, drive):
    """From 0.3 to 0.9 N at 15 mm: until the tissue is loaded so far the tip does not cut.
    Whatever the step, it waits as long, and the base meets the same force."""
    hard = {"name": "hard", "shape": "half_space", "center": [0, 0, -0.015], "cutting_force": 0.9}
    runs = []
    for dt in (0.05, 0.01):
        sim = simulator({**STRAIGHT, "tissue.regions": [hard]})
        ticks = drive(sim, 12.0, DOWN, dt=dt)[round(0.05 / dt) - 1 :: round(0.05 / dt)]
        runs.append(np.array([(o.insertion_depth, o.base_force[2], o.tip_force) for o in ticks]))
        depth, _, tip = runs[-1].T
        waiting = (tip > 0.4) & (tip < 0.88) & (depth > 2 * BEVEL)
        assert waiting.sum() >= 5
        np.testing.assert_allclose(depth[waiting], 0.015, atol=2 * DEPTH_TOLERANCE)
        np.testing.assert_allclose(tip[depth > 0.0155], 0.9, rtol=1e-9)
    np.testing.assert_allclose(runs[0][:, 0], runs[1][:, 0], atol=2 * DEPTH_TOLERANCE)
    np.testing.assert_allclose(runs[0][:, 1], runs[1][:, 1], atol=0.01 * 1.2)


def test_layers_change_the_slope_of_the_force(simulator, drive):
    """Fig. 3, DEFG: kinetic 14 N/m above 15 mm depth, 42 N/m below."""
    deep = {
        "name": "deep",
        "shape": "half_space",
        "center": [0, 0, -0.015],
        "friction_static": 42.0,
        "friction_kinetic": 42.0,
        "cutting_force": 0.5,
    }
    sim = simulator({**STRAIGHT, "tissue.regions": [deep]})
    ticks = of(drive(sim, 14.0, DOWN), Process.INSERTION)
    depth = np.array([o.insertion_depth for o in ticks])
    friction = np.array([o.friction_force for o in ticks])
    tip = np.array([o.tip_force for o in ticks])
    for part, slope, cutting in (
        ((depth > 7e-3) & (depth < 13e-3), 14.0, 0.3),
        (depth > 18e-3, 42.0, 0.5),
    ):
        assert part.sum() > 20
        assert np.polyfit(depth[part], friction[part], 1)[0] == pytest.approx(slope, rel=0.02)
        np.testing.assert_allclose(tip[part], cutting, rtol=1e-9)


def test_without_friction_and_cutting_the_needle_passes(simulator, drive):
    """Nothing resists: no force, and the depth is what the base pushed."""
    sim = simulator(
        {
            **STRAIGHT,
            "interaction": {"friction": {"static": 0.0, "kinetic": 0.0}, "cutting": {"force": 0.0}},
        }
    )
    o = drive(sim, 10.0, DOWN)[-1]
    assert np.abs(o.base_force).max() < 1e-9
    assert o.insertion_depth == pytest.approx(0.02, abs=DEPTH_TOLERANCE)


def test_free_faces_are_softer(coarse_scene, simulator, drive):
    """Held at the bottom only, the same push meets less force; both are the tissue's own."""
    forces = []
    for fixed in (["left", "right", "bottom"], ["bottom"]):
        changes = {**STRAIGHT, "tissue.fixed": fixed}
        o = drive(simulator(changes), 3.6, DOWN)[-1]
        assert o.process is Process.CONTACT
        expected = -o.tip_position[2] / pressed_compliance(coarse_scene(changes))[1, 1]
        assert o.tip_force == pytest.approx(expected, rel=1e-9)
        forces.append(o.tip_force)
    assert forces[1] < 0.98 * forces[0]
