# SPDX-License-Identifier: Apache-2.0
"""Commands that cannot be carried out leave the state bit for bit as it was."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, CommandError, Simulator
from needle_sim_ros.geometry import from_rotation_vector, multiply
from needle_sim_ros.interaction.process import Process

NAN, INF = float("nan"), float("inf")
DOWN = (0, 0, -3e-3)
# pointing down: half a turn about x
POINTING_DOWN = [1.0, 0.0, 0.0, 0.0]
STATES = {"above": 1.0, "touching": 3.5, "inside": 9.0}


def everything(sim):
    o = sim.observe()
    arrays = [o.tip_position, o.base_force, o.contact_forces, o.needle_points, o.base_torque]
    return sim.snapshot(), o.process, o.time, [a.tobytes() for a in arrays]


@pytest.fixture(params=STATES)
def state(request):
    return request.param


@pytest.fixture
def reached(simulator, drive, state):
    sim = simulator()
    drive(sim, STATES[state], DOWN)
    return sim


def refused(sim, command, dt, words):
    before = everything(sim)
    with pytest.raises(CommandError, match=words):
        sim.step(command, dt)
    after = everything(sim)
    assert after[0] is before[0]
    assert after[1:] == before[1:]


@pytest.mark.parametrize("dt", [0.0, -0.01, NAN, INF, -INF])
def test_impossible_durations(reached, dt):
    refused(reached, BaseCommand(velocity=DOWN), dt, "dt")


@pytest.mark.parametrize("dt", [0.015, 0.001, 0.0099, 1e-9])
def test_durations_between_newmark_s_steps(simulator, dt):
    sim = simulator({"solver.dynamics": "newmark"})
    refused(sim, BaseCommand(velocity=DOWN), dt, r"whole multiple of solver\.time_step, 0\.01 s")


@pytest.mark.parametrize("multiple", [1, 3])
def test_multiples_of_newmark_s_step_are_substeps(coarse_scene, multiple):
    """Three steps in one tick end where three ticks end."""
    one, other = (Simulator(coarse_scene({"solver.dynamics": "newmark"})) for _ in range(2))
    command = BaseCommand(velocity=(0, 0, -0.03))
    for _ in range(60):
        for _ in range(multiple):
            one.step(command, 0.01)
        other.step(command, 0.01 * multiple)
    np.testing.assert_allclose(other.observe().tip_position, one.observe().tip_position, atol=1e-12)
    np.testing.assert_allclose(other.observe().base_force, one.observe().base_force, atol=1e-7)


def test_out_of_the_plane(reached):
    refused(reached, BaseCommand(velocity=[0, 1e-3, 0]), 0.1, "plane")
    refused(reached, BaseCommand(position=[0, 1e-3, 0.14]), 0.1, "plane")
    refused(reached, BaseCommand(angular_velocity=[0.1, 0, 0]), 0.1, "about y only")
    refused(reached, BaseCommand(angular_velocity=[0, 0, 0.1]), 0.1, "about y only")


@pytest.mark.filterwarnings("ignore:overflow")
def test_beyond_all_numbers(reached):
    refused(reached, BaseCommand(velocity=[1e308, 0, 0]), 1e3, "not finite")


def test_the_base_into_the_tissue(simulator, drive):
    sim = simulator()
    drive(sim, STATES["inside"], DOWN)
    refused(sim, BaseCommand(position=[0, 0, -1e-3]), 0.1, "base would enter the tissue")
    refused(sim, BaseCommand(position=[0, 0, 0.0]), 0.1, "base would enter the tissue")


def test_the_whole_needle_or_through_the_bottom(simulator, drive):
    sim = simulator()
    drive(sim, STATES["inside"], DOWN)
    refused(sim, BaseCommand(position=[0, 0, 1e-3]), 0.1, "leave the tissue|whole length")


def test_in_from_below(simulator):
    """Round the block and up into its bottom."""
    sim = simulator({"needle.length": 0.3, "base.position": [0, 0, 0.31]})
    for place in ([0.07, 0, 0.31], [0.07, 0, 0.2], [0.07, 0, 0.21]):
        sim.step(BaseCommand(position=place), 1.0)
    refused(sim, BaseCommand(position=[0.05, 0, 0.25]), 1.0, "through a side|from below")


def test_turning_out_of_the_tissue(simulator, drive):
    sim = simulator()
    drive(sim, STATES["inside"], DOWN)
    for angle in (1.5, -1.5, 3.0):
        turned = multiply(from_rotation_vector([0, angle, 0]), POINTING_DOWN)
        refused(sim, BaseCommand(orientation=turned), 0.1, "turn out of the tissue")


def test_far_beside_the_entry(simulator, drive):
    sim = simulator()
    drive(sim, STATES["inside"], DOWN)
    refused(sim, BaseCommand(position=[1.0, 0, 0.12]), 0.1, "beside the entry")


def test_in_through_a_side(simulator):
    """Beside the block, down, and then sideways into it."""
    sim = simulator()
    sim.step(BaseCommand(position=[0.07, 0, 0.14]), 1.0)
    sim.step(BaseCommand(position=[0.07, 0, 0.10]), 1.0)
    refused(sim, BaseCommand(position=[0.0, 0, 0.10]), 1.0, "through a side")
    o = sim.step(BaseCommand(position=[0.07, 0, 0.14]), 1.0)
    assert not o.base_force.any()


def test_out_through_a_side(coarse_scene, drive):
    """Near a side, a bevel that turns towards it: refused where the track would leave."""
    steep = {"base.position": [0.05, 0, 0.14], "needle.tip.deviation_angle": 0.6}
    sim = Simulator(coarse_scene(steep))
    with pytest.raises(CommandError, match="leave the tissue"):
        for _ in range(600):
            before = everything(sim)
            sim.step(BaseCommand(velocity=DOWN), 0.1)
    assert everything(sim)[0] is before[0]
    o = sim.observe()
    assert o.insertion_depth > 0.01 and o.contact_points[-1, 0] > 0.055
    # it can still be drawn out
    assert drive(sim, 25.0, (0, 0, 3e-3), dt=0.1)[-1].process.value == "free"


@pytest.mark.parametrize(
    "dynamics",
    [
        {},
        {"solver.dynamics": "newmark", "solver.modes": 20},
    ],
)
def test_going_on_after_refusals_is_as_if_they_had_not_been(coarse_scene, dynamics):
    """Refusals after every tick of one of two simulators; they end with the same bits."""
    plain, pestered = (Simulator(coarse_scene(dynamics)) for _ in range(2))
    command = BaseCommand(velocity=DOWN)
    for _ in range(60):
        plain.step(command, 0.1)
        pestered.step(command, 0.1)
        for bad, dt in (
            (BaseCommand(position=[0, 1.0, 0.1]), 0.1),
            (BaseCommand(velocity=DOWN), -1.0),
            (BaseCommand(angular_velocity=[1.0, 0, 0]), 0.1),
        ):
            with pytest.raises(CommandError):
                pestered.step(bad, dt)
    assert everything(plain)[1:] == everything(pestered)[1:]


def test_a_twist_is_the_pose_it_leads_to(simulator):
    """Velocity and turn held for a tick, or the pose at its end."""
    twist, pose = simulator(), None
    o = twist.step(BaseCommand(velocity=[1e-3, 0, -2e-3], angular_velocity=[0, 0.02, 0]), 0.5)
    np.testing.assert_allclose(o.base_position, [5e-4, 0, 0.139], atol=1e-15)
    turned = multiply(from_rotation_vector([0, 0.01, 0]), POINTING_DOWN)
    np.testing.assert_allclose(np.abs(o.base_orientation), np.abs(turned), atol=1e-12)
    seen = o.tip_position.copy()
    pose = simulator()
    p = pose.step(BaseCommand(position=o.base_position, orientation=turned), 0.5)
    np.testing.assert_allclose(p.tip_position, seen, atol=1e-12)


def test_no_command_stands_still(simulator, drive):
    sim = simulator()
    drive(sim, 2.0, DOWN)
    before = sim.observe()
    after = sim.step(BaseCommand(), 0.5)
    np.testing.assert_array_equal(after.base_position, before.base_position)
    assert after.time == pytest.approx(before.time + 0.5)


def test_beneath_the_tissue_the_needle_is_free(simulator):
    """Beside it, down, and then sideways under it: nothing is touched."""
    sim = simulator({"needle.length": 0.3, "base.position": [0, 0, 0.31]})
    for place in ([0.07, 0, 0.31], [0.07, 0, 0.15], [0.04, 0, 0.15], [0.07, 0, 0.15]):
        seen = sim.step(BaseCommand(position=place), 1.0)
        assert seen.process is Process.FREE
        assert not seen.base_force.any()
