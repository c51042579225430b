# SPDX-License-Identifier: Apache-2.0
"""Footprints in 3D: means over the disc perpendicular to the track."""

import numpy as np
import pytest

from needle_sim_ros import Scene
from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.tissue.model import TissueModel

RADIUS, SPACING = 1e-3, 3e-3
POINT = np.array([0.003, -0.002, -0.021])
HEADINGS = [(0.0, 0.0, -1.0), (0.4, 0.0, -1.0), (0.3, -0.5, -1.0)]


@pytest.fixture(scope="module")
def model():
    """Triquadratic cells 12 mm wide: the moments of a disc are exact on them."""
    return TissueModel(
        Scene.from_dict(
            {
                "name": "block",
                "dimension": 3,
                "tissue": {
                    "size": [0.06, 0.06, 0.06],
                    "youngs_modulus": 15e3,
                    "poisson_ratio": 0.45,
                    "mesh": {
                        "element": "quad2",
                        "uniform": True,
                        "spacing_across": 0.012,
                        "spacing_along": 0.012,
                    },
                },
                "needle": {"length": 0.08, "radius": RADIUS, "youngs_modulus": 2e11},
                "solver": {"track_spacing": 0.012},
            }
        )
    )


@pytest.fixture(scope="module")
def coupling(model):
    return Coupling(model, RADIUS)


def unit(vector):
    return np.array(vector) / np.linalg.norm(vector)


def mean(model, footprint, field):
    return footprint.weights @ field(model.coordinates[:, footprint.nodes].T)


@pytest.mark.parametrize("heading", HEADINGS)
def test_weights_and_center(model, coupling, heading):
    """Rigid displacements and linear fields are sampled exactly, at the point."""
    along = SPACING * unit(heading)
    for footprint in (
        coupling.hat(POINT - along, POINT, POINT + along),
        coupling.section(POINT, unit(heading)),
    ):
        assert footprint.weights.sum() == pytest.approx(1.0, abs=1e-13)
        assert len(set(footprint.nodes)) == len(footprint.nodes)
        np.testing.assert_allclose(mean(model, footprint, lambda x: x), POINT, atol=1e-14)


@pytest.mark.parametrize("heading", HEADINGS)
def test_second_moments_of_disc_and_hat(model, coupling, heading):
    """r^2 / 4 in both directions of the disc, nothing along it; h^2 / 6 along the hat."""
    along = unit(heading)
    across = 0.25 * RADIUS**2 * (np.eye(3) - np.outer(along, along))

    def moments(x):
        offset = x - POINT
        return (offset[:, :, None] * offset[:, None, :]).reshape(len(x), 9)

    section = mean(model, coupling.section(POINT, along), moments).reshape(3, 3)
    np.testing.assert_allclose(section, across, atol=1e-9 * RADIUS**2)
    step = SPACING * along
    hat = mean(model, coupling.hat(POINT - step, POINT, POINT + step), moments).reshape(3, 3)
    expected = across + SPACING**2 / 6 * np.outer(along, along)
    np.testing.assert_allclose(hat, expected, atol=1e-9 * RADIUS**2)


def test_at_the_surface_only_the_part_in_the_tissue_counts(model, coupling):
    footprint = coupling.section(np.zeros(3), unit((0.3, 0.5, -1.0)))
    assert mean(model, footprint, lambda x: x)[2] < -0.1 * RADIUS
    assert footprint.weights.sum() == pytest.approx(1.0, abs=1e-13)


def test_what_lies_ahead_is_touched_later(model, coupling):
    """Nodes named ahead of a straight track hold the footprints of its next points."""
    down = np.array([0.0, 0.0, -1.0])
    ahead = set(coupling.ahead(POINT, down, 6 * SPACING))
    for k in range(1, 5):
        point = POINT + k * SPACING * down
        hat = coupling.hat(point - SPACING * down, point, point + SPACING * down)
        assert set(hat.nodes) <= ahead
