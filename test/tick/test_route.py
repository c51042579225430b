# SPDX-License-Identifier: Apache-2.0
"""The way of the base in a tick: in proportion to time, turns included."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_sim_ros import BaseCommand
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.tick.base_motion import commanded
from needle_sim_ros.tick.route import Route

PLACE = np.array([0.01, 0.0, 0.14])
DOWN = np.array([1.0, 0.0, 0.0, 0.0])


def route(**command):
    pose = BasePose.of(PLACE, DOWN, 2)
    return Route(PLACE, DOWN, pose, commanded(BaseCommand(**command), PLACE, DOWN, 0.1), 0.1)


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


def test_a_turn_sweeps_the_needle():
    assert route(angular_velocity=(0.0, 2.0, 0.0)).swept(0.1) == pytest.approx(0.02)
    assert route(velocity=(0.03, 0.0, -0.04)).swept(0.1) == pytest.approx(5e-3)


def test_what_the_needle_dragged_goes_on_when_it_stops():
    pose = BasePose.of(PLACE, DOWN, 2)
    rest = commanded(BaseCommand(), PLACE, DOWN, 0.1)
    assert Route(PLACE, DOWN, pose, rest, 0.1, (0, 0, -0.05, 0, 0, 0)).fastest(0.1) == 0.05
    assert Route(PLACE, DOWN, pose, rest, 0.1).fastest(0.1) == 0.0
