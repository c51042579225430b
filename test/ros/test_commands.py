# SPDX-License-Identifier: Apache-2.0
"""What the stage makes of commands: newest wins, timeout, speed limits, refusals."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from needle_sim_ros.geometry import conjugate, multiply, to_rotation_vector
from needle_sim_ros.ros.commands import StageCommands, StageLimits
from needle_sim_ros.session.motion import STILL

DT = 0.01
DOWN = (1.0, 0.0, 0.0, 0.0)
HERE = (0.0, 0.0, 0.14)
LIMITS = StageLimits(speed=0.1, angular_speed=1.0, jump=0.5, timeout=0.5)


def stage(**changes):
    return StageCommands("tissue", replace(LIMITS, **changes))


def angle_between(a, b):
    return np.linalg.norm(to_rotation_vector(multiply(conjugate(a), b)))


def test_without_a_command_the_stage_stands_still():
    commands = stage()
    assert commands.motion(HERE, DOWN, 0.0, DT) is STILL
    assert commands.age(1.0) is None


def test_the_newest_command_wins_whatever_its_kind():
    commands = stage()
    commands.velocity((0, 0, -0.003), (0, 0, 0), "tissue", 0.0)
    commands.velocity((0, 0, -0.005), (0, 0, 0), "tissue", 0.0)
    assert commands.motion(HERE, DOWN, 0.0, DT).linear == (0, 0, -0.005)
    assert commands.pose((0, 0, 0.1395), DOWN, "", 0.0, HERE) is None
    assert commands.motion(HERE, DOWN, 0.0, DT).kind == "pose"
    assert commands.received == 3


def test_a_velocity_holds_for_exactly_its_timeout():
    commands = stage()
    commands.velocity((0, 0, -0.003), (0, 0, 0), "tissue", 0.30)
    motions = [commands.motion(HERE, DOWN, 0.30 + k * DT, DT) for k in range(60)]
    assert [motion is not STILL for motion in motions] == [True] * 50 + [False] * 10
    assert commands.timeouts == 1
    assert commands.timed_out
    commands.velocity((0, 0, -0.003), (0, 0, 0), "tissue", 1.0)
    assert not commands.timed_out
    assert commands.motion(HERE, DOWN, 1.0, DT) is not STILL


def test_no_timeout_when_it_is_zero():
    commands = stage(timeout=0.0)
    commands.velocity((0, 0, -0.003), (0, 0, 0), "tissue", 0.0)
    assert commands.motion(HERE, DOWN, 1e6, DT) is not STILL


def test_a_pose_is_approached_at_the_speed_limit_and_reached_exactly():
    commands = stage(timeout=0.0)
    target = (0.0, 0.0123, 0.12)
    commands.pose(target, DOWN, "tissue", 0.0, HERE)
    position, ticks = HERE, 0
    while position != target:
        motion = commands.motion(position, DOWN, ticks * DT, DT)
        assert math.dist(position, motion.linear) <= 0.1 * DT * (1 + 1e-12)
        position, ticks = motion.linear, ticks + 1
    assert ticks == math.ceil(math.dist(HERE, target) / (0.1 * DT))
    assert commands.motion(position, DOWN, ticks * DT, DT).linear == target


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_turn_is_limited_too_and_goes_the_short_way(sign):
    commands = stage(timeout=0.0)
    angle = 0.9
    turned = tuple(sign * q for q in (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0))
    commands.pose(HERE, turned, "tissue", 0.0, HERE)
    orientation, ticks = DOWN, 0
    while angle_between(orientation, turned) > 1e-9:
        motion = commands.motion(HERE, orientation, 0.0, DT)
        step = angle_between(orientation, motion.angular)
        assert step <= 1.0 * DT * (1 + 1e-9)
        assert math.hypot(*motion.angular) == pytest.approx(1.0, abs=1e-12)
        orientation, ticks = motion.angular, ticks + 1
    assert ticks == math.ceil(angle / DT)


def test_position_and_orientation_arrive_together():
    commands = stage(timeout=0.0)
    turned = (math.cos(0.1), 0.0, math.sin(0.1), 0.0)
    commands.pose((0.0, 0.0, 0.13), turned, "tissue", 0.0, HERE)
    motion = commands.motion(HERE, DOWN, 0.0, DT)
    gone = math.dist(HERE, motion.linear) / 0.01
    assert angle_between(DOWN, motion.angular) / 0.2 == pytest.approx(gone, rel=1e-9)
    assert gone == pytest.approx(0.05)  # the turn is the slower of the two


def test_a_twist_that_is_too_fast_is_slowed_as_a_whole():
    commands = stage()
    commands.velocity((0.0, 0.3, -0.4), (0.0, 1.0, 0.0), "tissue", 0.0)
    motion = commands.motion(HERE, DOWN, 0.0, DT)
    np.testing.assert_allclose(motion.linear, (0.0, 0.06, -0.08))
    np.testing.assert_allclose(motion.angular, (0.0, 0.2, 0.0))


HOSTILE = [
    ("not finite", (math.nan, 0, 0.14), DOWN, "tissue"),
    ("not finite", (0, math.inf, 0.14), DOWN, "tissue"),
    ("not finite", HERE, (1.0, 0.0, math.nan, 0.0), "tissue"),
    ("zero quaternion", HERE, (0.0, 0.0, 0.0, 0.0), "tissue"),
    ("frame is not tissue", HERE, DOWN, "map"),
    ("jump of more than 0.5 m", (1.0, 0.0, 0.14), DOWN, "tissue"),
    ("jump of more than 0.5 m", (1e308, 1e308, 1e308), DOWN, "tissue"),
]


@pytest.mark.parametrize("reason, position, orientation, frame", HOSTILE)
def test_hostile_poses_are_counted_and_change_nothing(reason, position, orientation, frame):
    commands = stage()
    commands.velocity((0, 0, -0.003), (0, 0, 0), "tissue", 0.0)
    before = commands.motion(HERE, DOWN, 0.1, DT)
    assert commands.pose(position, orientation, frame, 0.1, HERE) == reason
    assert commands.motion(HERE, DOWN, 0.1, DT) is before
    assert commands.rejected == {reason: 1}
    assert commands.rejected_count == 1
    assert commands.received == 2


@pytest.mark.parametrize(
    "reason, linear, angular, frame",
    [
        ("not finite", (0, 0, math.nan), (0, 0, 0), "tissue"),
        ("not finite", (0, 0, 0), (0, -math.inf, 0), "tissue"),
        ("frame is not tissue", (0, 0, 0), (0, 0, 0), "needle_base"),
    ],
)
def test_hostile_velocities_are_counted_and_change_nothing(reason, linear, angular, frame):
    commands = stage()
    assert commands.velocity(linear, angular, frame, 0.0) == reason
    assert commands.motion(HERE, DOWN, 0.0, DT) is STILL
    assert commands.rejected == {reason: 1}


def test_a_command_that_the_simulator_refuses_is_forgotten():
    commands = stage()
    commands.velocity((0, 0.003, 0), (0, 0, 0), "tissue", 0.0)
    commands.refuse_current("CommandError")
    assert commands.motion(HERE, DOWN, 0.0, DT) is STILL
    assert commands.rejected == {"CommandError": 1}


numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(st.tuples(*[numbers] * 3), st.tuples(*[numbers] * 4), st.tuples(*[numbers] * 3))
@example((0.0, 0.0, 0.0), (0.0, 0.0, 1.3e308, 1.3e308), (0.0, 0.0, 0.0))  # its norm is no number
@example((0.0, 0.0, 0.0), (0.0, math.inf, 1e300, 1e300), (0.0, 0.0, 0.0))
def test_whatever_comes_the_stage_keeps_its_limits(position, orientation, velocity):
    commands = stage(timeout=0.0)
    accepted = commands.pose(position, orientation, "tissue", 0.0, HERE) is None
    motion = commands.motion(HERE, DOWN, 0.0, DT)
    assert (motion is STILL) == (not accepted)
    if accepted:
        assert math.dist(HERE, motion.linear) <= 0.1 * DT * (1 + 1e-9)
        assert math.hypot(*motion.angular) == pytest.approx(1.0, abs=1e-9)
        assert angle_between(DOWN, motion.angular) <= DT * (1 + 1e-6)
    if commands.velocity(velocity, position, "tissue", 0.0) is None:
        motion = commands.motion(HERE, DOWN, 0.0, DT)
        assert math.hypot(*motion.linear) <= 0.1 * (1 + 1e-9)
        assert math.hypot(*motion.angular) <= 1.0 + 1e-9
