# SPDX-License-Identifier: Apache-2.0
"""Base commands: admissible ones are kept exactly, others say what is wrong."""

import math

import numpy as np
import pytest

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import CommandError


def test_nothing_given_stands_still():
    command = BaseCommand()
    assert command.position is command.orientation is command.velocity is None
    assert command.angular_velocity is None


def test_quaternions_are_normalised():
    command = BaseCommand(orientation=[0, 3, 0, 4])
    np.testing.assert_allclose(command.orientation, [0, 0.6, 0, 0.8], rtol=1e-15)


@pytest.mark.parametrize("huge", [1e160, 1.3e308])
def test_quaternions_whose_norm_is_beyond_all_numbers_are_normalised(huge):
    command = BaseCommand(orientation=[0, 0.75 * huge, 0, huge])
    np.testing.assert_allclose(command.orientation, [0, 0.6, 0, 0.8], rtol=1e-15)


def test_a_command_does_not_change_with_its_source():
    velocity = np.array([0.0, 0.0, -1e-3])
    command = BaseCommand(velocity=velocity)
    velocity[2] = 5.0
    assert command.velocity[2] == -1e-3
    with pytest.raises(ValueError, match="read-only"):
        command.velocity[0] = 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"position": [0, 0]}, r"position has shape \(2,\)"),
        ({"position": [0, 0, math.nan]}, "position = .* must be finite"),
        ({"velocity": [math.inf, 0, 0]}, "velocity = .* must be finite"),
        ({"angular_velocity": "fast"}, "angular_velocity = 'fast'"),
        ({"velocity": [1, 2, "x"]}, "must be 3 numbers"),
        ({"orientation": [0, 0, 0, 0]}, "zero quaternion"),
        ({"orientation": [0, 0, 1]}, r"must be \(4,\)"),
        ({"position": [0, 0, 0], "velocity": [0, 0, 0]}, "either a pose or a twist"),
        ({"orientation": [0, 0, 0, 1], "angular_velocity": [0, 0, 0]}, "either a pose or a twist"),
    ],
)
def test_what_is_refused(arguments, words):
    with pytest.raises(CommandError, match=words):
        BaseCommand(**arguments)
