# SPDX-License-Identifier: Apache-2.0
"""Footprints: means over the needle's cross-section, weighted along the track."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.interaction.spreading import coverage
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel

RADIUS, SPACING = 1e-3, 2e-3
angles = st.floats(-1.0, 1.0)


@pytest.fixture(scope="module")
def model(coarse_scene):
    return TissueModel(coarse_scene())


@pytest.fixture(scope="module")
def coupling(model):
    return Coupling(model, RADIUS)


def heading(angle):
    return np.array([math.sin(angle), -math.cos(angle)])


def mean(model, footprint, field):
    return float(footprint.weights @ field(*model.coordinates[:, footprint.nodes]))


@given(x=st.floats(-0.05, 0.05), depth=st.floats(0.0, 0.07), angle=angles)
@settings(max_examples=40)
def test_weights_add_up_to_one(model, coupling, x, depth, angle):
    """A rigid displacement of the tissue is sampled exactly, at the surface too."""
    point, step = np.array([x, -depth]), SPACING * heading(angle)
    for footprint in (
        coupling.hat(point - step, point, point + step),
        coupling.section(point, heading(angle)),
    ):
        assert footprint.weights.sum() == pytest.approx(1.0, abs=1e-13)
        assert len(set(footprint.nodes)) == len(footprint.nodes)


@given(x=st.floats(-0.05, 0.05), depth=st.floats(0.01, 0.07), angle=angles)
@settings(max_examples=40)
def test_center(model, coupling, x, depth, angle):
    """A linear field is sampled at the centre of gravity: of a hat the point itself, of a
    cross-section its middle."""
    point, along = np.array([x, -depth]), heading(angle)

    def field(at_x, at_z):
        return 3 + 2 * at_x - 5 * at_z

    whole = coupling.hat(point - SPACING * along, point, point + SPACING * along)
    assert mean(model, whole, field) == pytest.approx(field(*point), abs=1e-12)
    section = coupling.section(point, along)
    assert mean(model, section, field) == pytest.approx(field(*point), abs=1e-12)


def test_chord_and_hat_by_their_second_moments(model, coupling):
    """Vertical needle, field x^2 z^0: r^2/3; field z^2 about the point: h^2/6 (hat of half
    width h). Both are quadratic, so that biquadratic elements hold them exactly."""
    point, down = np.array([0.003, -0.031]), np.array([0.0, -1.0])
    footprint = coupling.hat(point - SPACING * down, point, point + SPACING * down)
    across = mean(model, footprint, lambda x, z: (x - point[0]) ** 2)
    along = mean(model, footprint, lambda x, z: (z - point[1]) ** 2)
    assert across == pytest.approx(RADIUS**2 / 3, rel=1e-8)
    assert along == pytest.approx(SPACING**2 / 6, rel=1e-8)


def test_cross_section_is_perpendicular_to_the_track(model, coupling):
    """Lying at 30 deg the chord's second moment about x is r^2/3 cos^2 30."""
    point, along = np.array([0.003, -0.031]), heading(math.pi / 6)
    across = mean(model, coupling.section(point, along), lambda x, z: (x - point[0]) ** 2)
    assert across == pytest.approx(RADIUS**2 / 3 * math.cos(math.pi / 6) ** 2, rel=1e-8)


def test_at_the_surface_only_the_part_in_the_tissue_counts(model, coupling):
    """Entering at 30 deg one half of the chord at the entry is in the air."""
    footprint = coupling.section(np.zeros(2), heading(math.pi / 6))
    lowest = mean(model, footprint, lambda x, z: z)
    assert lowest < -0.1 * RADIUS
    assert footprint.weights.sum() == pytest.approx(1.0, abs=1e-13)


def test_reciprocity(model, coupling):
    """u sampled at footprint k under a force spread by l, and the converse (Maxwell-Betti)."""
    factor = Factor(model.stiffness)
    step = SPACING * heading(0.2)
    points = [np.array([0.0, -0.004]), np.array([0.01, -0.03]), np.array([-0.002, -0.006])]
    prints = [coupling.hat(p - step, p, p + step) for p in points]

    def loads(footprint, axis):
        full = np.zeros((model.nodes, 2))
        full[footprint.nodes, axis] = footprint.weights
        return full.ravel()[model.free]

    vectors = np.array([loads(p, axis) for p in prints for axis in (0, 1)]).T
    answers = vectors.T @ factor.solve(vectors)
    np.testing.assert_allclose(answers, answers.T, atol=1e-10 * np.abs(answers).max())


depths = st.floats(0.0, 0.05)


@given(depth=depths)
@settings(max_examples=100)
def test_coverage_adds_up_to_the_depth(depth):
    count = math.ceil(depth / SPACING) + 2
    assert coverage(depth, count, SPACING).sum() == pytest.approx(depth, abs=1e-15)


@given(depth=depths)
@settings(max_examples=30)
def test_coverage_is_the_integral_of_the_hats(depth):
    """Against a quadrature of hat k from the entry to the depth."""
    count = 26
    found = coverage(depth, count, SPACING)
    edges = np.union1d(np.arange(count) * SPACING, depth)
    edges = edges[edges <= depth]
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    hats = np.maximum(0, 1 - np.abs(middle[None, :] / SPACING - np.arange(count)[:, None]))
    np.testing.assert_allclose(found, hats @ width, atol=1e-15)


def test_coverage_is_monotone_and_smooth():
    """No point carries less as the tip advances, and its length grows without a kink:
    the second difference of a function with slopes in [0, 1] within 2 h is bounded by 1 / h."""
    step = 1e-6
    deep = np.arange(0.0, 0.01, step)
    lengths = np.array([coverage(d, 6, SPACING) for d in deep])
    slopes = np.diff(lengths, axis=0) / step
    assert slopes.min() >= -1e-9 and slopes.max() <= 1 + 1e-9
    bends = np.diff(slopes, axis=0) / step
    assert np.abs(bends).max() <= 1.01 / SPACING
