# SPDX-License-Identifier: Apache-2.0
"""What a command does to the base, and what counts as a jump of its motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_sim_ros import BaseCommand
from needle_sim_ros.tick.base_motion import (
    AT_REST,
    commanded,
    fastest,
    jumps,
    part_way,
)

PLACE = np.array([0.01, 0.0, 0.14])
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
LENGTH = 0.13

speed = st.floats(-1.0, 1.0)


@given(st.tuples(speed, speed, speed))
def test_a_velocity_is_held_for_the_tick(velocity):
    motion = commanded(BaseCommand(velocity=velocity), PLACE, DOWN, 0.02)
    np.testing.assert_allclose(motion.position, PLACE + 0.02 * np.array(velocity), atol=1e-17)
    np.testing.assert_allclose(motion.rate[:3], velocity, atol=1e-14)
    assert motion.orientation is DOWN and motion.rate[3:] == (0.0, 0.0, 0.0)


def test_nothing_given_means_standing_still():
    motion = commanded(BaseCommand(), PLACE, DOWN, 0.02)
    assert motion.position is PLACE and motion.rate == AT_REST


@given(st.floats(-1.0, 1.0), st.floats(0.0, 1.0))
def test_part_way_of_a_turn_turns_in_proportion(rate, share):
    """About y: the quaternion's half angle, the share of the whole."""
    motion = commanded(BaseCommand(angular_velocity=(0.0, rate, 0.0)), PLACE, DOWN, 0.5)
    place, orientation = part_way(motion, PLACE, DOWN, share)
    angle = 0.5 * 0.5 * rate * share
    expected = [math.cos(angle), 0.0, -math.sin(angle), 0.0]
    np.testing.assert_allclose(orientation, expected, atol=1e-14)
    np.testing.assert_array_equal(place, PLACE)


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ((0, 0, -3e-3), (0, 0, -3e-3), False),
        ((0, 0, -3e-3), (0, 0, -3.3e-3), False),  # a stage that is not quite even
        ((0, 0, -3e-3), (0, 0, 0), True),
        ((0, 0, -3e-3), (0, 0, 3e-3), True),
        ((0, 0, 0), (1e-6, 0, 0), True),
        ((0, 0, -3e-3), (1e-3, 0, -3e-3), True),
    ],
)
def test_jumps_of_velocity(before, after, expected):
    still = (0.0, 0.0, 0.0)
    assert jumps((*after, *still), (*before, *still), LENGTH) is expected


def test_a_turn_that_begins_is_a_jump():
    assert jumps((0, 0, -3e-3, 0, 0.1, 0), (0, 0, -3e-3, 0, 0, 0), LENGTH)
    assert not jumps((0, 0, -3e-3, 0, 1e-3, 0), (0, 0, -3e-3, 0, 0, 0), LENGTH)


def test_the_fastest_of_base_and_needle():
    assert fastest((1e-3, 0, -3e-3, 0, 0, 0), LENGTH) == 3e-3
    assert fastest((1e-3, 0, -3e-3, 0, 0.1, 0), 0.13) == pytest.approx(0.013)
