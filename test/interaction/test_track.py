# SPDX-License-Identifier: Apache-2.0
"""The track: points at equal distance, friction limits of their place, places along it."""

import math

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
    "center": [0, 0, -0.0048],
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
    track = layer.touch(np.zeros(2), DOWN)
    for direction in (DOWN, DOWN, ASIDE, ASIDE):
        track = extended(layer, track, direction)
    return track


def extended(layer, track, heading):
    return layer.extend(layer.ask(layer.gather(layer.spread(layer.aim(track, heading))), 0.0))


# each heading turns the last segment, laid as it was foreseen, and the next point follows it
POINTS = np.cumsum([0 * DOWN, DOWN, ASIDE, ASIDE, ASIDE], axis=0) * SPACING


def test_points_stand_a_spacing_apart(track):
    """Straight pieces along the headings in their middles."""
    np.testing.assert_allclose(track.points, POINTS, atol=1e-16)
    steps = np.linalg.norm(np.diff(track.points, axis=0), axis=1)
    np.testing.assert_allclose(steps, SPACING, rtol=1e-13)
    assert track.laid == track.table.count == 5


def test_a_turning_track_converges_with_the_square_of_the_spacing(coarse_scene, layer):
    """A quarter of a circle of radius 40 mm: halving the spacing quarters the miss."""
    misses = []
    for count in (20, 40):
        spacing = 0.04 * math.pi / 4 / count
        finer = TrackLayer(layer.coupling, layer.laws, layer._empty.table, spacing)
        track = finer.touch(np.zeros(2), DOWN)
        for k in range(count + 1):
            angle = max(k - 0.5, 0.0) * spacing / 0.04  # in the middle of the last segment
            heading = np.array([math.sin(angle), -math.cos(angle)])
            track = extended(finer, track, heading)
        end = 0.04 * np.array([1 - math.cos(math.pi / 4), -math.sin(math.pi / 4)])
        misses.append(np.linalg.norm(track.points[-2] - end))
    assert misses[1] < 0.3 * misses[0] < 0.3 * 2e-4


def test_the_faster_the_farther_it_has_responses_prepared(layer, monkeypatch):
    """In 2D 14 spacings, 28 mm here, or what the base goes in 0.6 s, 100 mm at most."""
    compliance, asked = layer._empty.table.compliance, []
    monkeypatch.setattr(compliance, "expect", asked.append)
    track = layer.touch(np.zeros(2), DOWN)
    while track.laid < 4:
        track = layer.extend(layer.aim(track, DOWN))
    aimed = layer.gather(layer.spread(layer.aim(track, DOWN)))
    for speed in (-0.1, 1e-3, 0.06, 1.0):
        told = layer.ask(aimed, speed)
        assert not told.ahead.asked  # which nodes these are is a step of its own
        assert layer.ask(told, speed).ahead.asked
    depth = layer.coupling._model.coordinates[-1]
    begun = aimed.ahead.point[-1]
    reached = [begun - depth[nodes].min() for nodes in asked]
    cell = 10e-3  # no larger anywhere near
    assert reached[0] == reached[1] == pytest.approx(28e-3, abs=cell)
    assert reached[2] == pytest.approx(36e-3, abs=cell) and reached[2] > reached[1]
    assert reached[3] > 60e-3  # to the bottom


def test_foresight_goes_on_turning(layer, track):
    """The next point lies along the last heading, or as far again beyond as it turned."""
    ahead = layer.aim(track, DOWN).ahead.point
    last = POINTS[3] + SPACING * DOWN
    np.testing.assert_allclose(ahead, last + SPACING * DOWN, atol=1e-16)
    ahead = layer.aim(track, DOWN, foresight=True).ahead.point
    np.testing.assert_allclose(ahead, last + SPACING * (2 * DOWN - ASIDE), atol=1e-16)


def test_limits_are_those_of_the_place(track):
    """Means over half a piece to either side: the layer begins at 5 mm, and three of the
    four places about the fourth point lie in it."""
    np.testing.assert_array_equal(track.static, [16, 16, 16, 34, 40])
    np.testing.assert_array_equal(track.kinetic, [14, 14, 14, 26, 30])


@pytest.mark.parametrize(
    ("depth", "place", "direction"),
    [
        (0.0, POINTS[0], DOWN),
        (1e-3, POINTS[1] / 2, DOWN),
        (5e-3, (POINTS[2] + POINTS[3]) / 2, ASIDE),
        (8e-3, POINTS[4], ASIDE),
        (9e-3, POINTS[4] + 1e-3 * ASIDE, ASIDE),
    ],
)
def test_places_along_the_track(track, depth, place, direction):
    np.testing.assert_allclose(track.at(depth), place, atol=1e-15)
    np.testing.assert_allclose(track.direction(depth), direction, atol=1e-12)


def test_extending_leaves_the_shorter_track_as_it_was(layer, track):
    before, points = track.table.between().copy(), track.points.copy()
    extended(layer, track, DOWN)
    extended(layer, track, ASIDE)
    np.testing.assert_array_equal(track.points, points)
    np.testing.assert_array_equal(track.table.between(), before)


def test_changed_laws_reach_the_points(coarse_scene, track):
    scene = coarse_scene({"interaction.friction": {"static": 9.0, "kinetic": 7.0}})
    changed = track.with_limits(Laws(scene))
    np.testing.assert_array_equal(changed.static, [9.0] * 5)
    np.testing.assert_array_equal(changed.kinetic, [7.0] * 5)
    np.testing.assert_array_equal(track.kinetic, [14, 14, 14, 26, 30])
