# SPDX-License-Identifier: Apache-2.0
"""The bevelled tip: its length and where it turns the cut to."""

import math

import numpy as np
import pytest

from needle_sim_ros.needle.tip import bevel_length, cutting_direction
from needle_sim_ros.scene import Needle, Tip

AXIAL, LATERAL = np.array([0.0, -1.0]), np.array([[1.0, 0.0]])
AXIAL_3D, LATERAL_3D = np.array([0.0, 0.0, -1.0]), np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def needle(**tip):
    return Needle(length=0.13, radius=1e-3, youngs_modulus=2.1e9, tip=Tip(**tip))


def test_bevel_length():
    """A face at 45 deg across a diameter of 2 mm is 2 mm long; at 20 deg 5.495 mm."""
    assert bevel_length(needle(bevel_angle=math.pi / 4)) == pytest.approx(2e-3, rel=1e-12)
    assert bevel_length(needle(bevel_angle=math.radians(20))) == pytest.approx(5.495e-3, rel=1e-4)


@pytest.mark.parametrize(("roll", "side"), [(0.0, 1.0), (math.pi, -1.0), (math.pi / 2, 0.0)])
def test_deviates_by_its_angle_to_the_side_of_the_roll(roll, side):
    direction = cutting_direction(
        needle(deviation_angle=0.1, roll=roll), AXIAL, LATERAL, np.zeros(1)
    )
    assert math.atan2(direction[0], -direction[1]) == pytest.approx(0.1 * side, abs=1e-12)
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-14)


def test_straight_needle_without_deviation_cuts_along_its_axis():
    direction = cutting_direction(needle(), AXIAL, LATERAL, np.zeros(1))
    np.testing.assert_array_equal(direction, AXIAL)


def test_follows_the_slope_of_the_needle():
    """A needle bent by a slope of 0.2 cuts along its tangent."""
    direction = cutting_direction(needle(), AXIAL, LATERAL, np.array([0.2]))
    assert direction[0] / -direction[1] == pytest.approx(0.2, rel=1e-12)


def test_roll_turns_the_cut_about_the_axis_in_space():
    """Half way between x and y of the base, at 0.1 rad to the axis."""
    direction = cutting_direction(
        needle(deviation_angle=0.1, roll=math.pi / 4), AXIAL_3D, LATERAL_3D, np.zeros(2)
    )
    assert math.acos(direction @ AXIAL_3D) == pytest.approx(0.1, rel=1e-9)
    assert direction @ LATERAL_3D[0] == pytest.approx(direction @ LATERAL_3D[1], rel=1e-12)
