# SPDX-License-Identifier: Apache-2.0
"""The track: points at equal distance, friction limits of their place, places along it."""

import numpy as np
import pytest

from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.track import TrackLayer
from needle_sim_ros.tissue.build import build_tissue
from needle_sim_ros.tissue.response import ResponseTable

SPACING = 2e-3
LAYER = {
    "name": "deep",
    "shape": "half_space",
    "center": [0, 0, -0.005],
    "friction_static": 40.0,
    "friction_kinetic": 30.0,
}
DOWN, ASIDE = np.array([0.0, -1.0]), np.array([0.6, -0.8])


@pytest.fixture(scope="module")
def layer(coarse_scene):
    scene = coarse_scene({"tissue.regions": [LAYER]})
    built = build_tissue(scene)
    coupling = Coupling(built.model, scene.needle.radius)
    return TrackLayer(coupling, Laws(scene), ResponseTable(built.dynamics.compliance), SPACING)


@pytest.fixture(scope="module")
def track(layer):
    track = layer.start(np.zeros(2), DOWN)
    for direction in (DOWN, ASIDE, ASIDE):
        track = layer.extend(track, direction)
    return track


def test_points_stand_a_spacing_apart(track):
    expected = [[0, 0], [0, -2e-3], [0, -4e-3], [1.2e-3, -5.6e-3], [2.4e-3, -7.2e-3]]
    np.testing.assert_allclose(track.points, expected, atol=1e-16)
    assert track.count == track.table.count == 5


def test_limits_are_those_of_the_place(track):
    np.testing.assert_array_equal(track.static, [16, 16, 16, 40, 40])
    np.testing.assert_array_equal(track.kinetic, [14, 14, 14, 30, 30])


@pytest.mark.parametrize(
    ("depth", "place", "direction"),
    [
        (0.0, [0, 0], DOWN),
        (1e-3, [0, -1e-3], DOWN),
        (5e-3, [0.6e-3, -4.8e-3], ASIDE),
        (8e-3, [2.4e-3, -7.2e-3], ASIDE),
        (9e-3, [3.0e-3, -8.0e-3], ASIDE),
    ],
)
def test_places_along_the_track(track, depth, place, direction):
    np.testing.assert_allclose(track.at(depth), place, atol=1e-15)
    np.testing.assert_allclose(track.direction(depth), direction, atol=1e-12)


def test_extending_leaves_the_shorter_track_as_it_was(layer, track):
    before, points = track.table.between().copy(), track.points.copy()
    layer.extend(track, DOWN)
    layer.extend(track, ASIDE)
    np.testing.assert_array_equal(track.points, points)
    np.testing.assert_array_equal(track.table.between(), before)


def test_changed_laws_reach_the_points(coarse_scene, track):
    scene = coarse_scene({"interaction.friction": {"static": 9.0, "kinetic": 7.0}})
    changed = track.with_limits(Laws(scene))
    np.testing.assert_array_equal(changed.static, [9.0] * 5)
    np.testing.assert_array_equal(changed.kinetic, [7.0] * 5)
    np.testing.assert_array_equal(track.kinetic, [14, 14, 14, 30, 30])
