# SPDX-License-Identifier: Apache-2.0
"""The graded mesh: it finds points, follows an inclined path, and grades as asked."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_sim_ros import SceneError
from needle_sim_ros.tissue.mesh import build_mesh, graded, planned_path, spacings
from needle_sim_ros.tissue.model import TissueModel

ELEMENTS = ["quad2", "quad1", "tri2", "tri1"]
HALF, DEPTH = 0.06, 0.08


def inclined(angle, entry=0.0):
    """Turn the needle by an angle (rad) about y; its tip starts 10 mm above the entry."""
    direction = np.array([-math.sin(angle), 0.0, -math.cos(angle)])
    tip = np.array([entry, 0.0, 0.0]) - 0.01 * direction
    half = angle / 2
    return {
        "base.position": (tip - 0.13 * direction).tolist(),
        # the base points down after half a turn about x, then leans
        "base.orientation": [math.cos(half), 0.0, -math.sin(half), 0.0],
        "protocol": [{"duration": 70 / 3, "velocity": (3e-3 * direction).tolist()}],
    }


def meshed(element, angle):
    """Both orders of elements need nodes no further apart than the track points."""
    along = 4e-3 if element.endswith("2") else 2e-3
    return {"tissue.mesh.element": element, "tissue.mesh.spacing_along": along, **inclined(angle)}


@pytest.fixture(scope="module")
def grid(coarse_scene):
    def make(element="quad2", angle=0.0):
        return build_mesh(coarse_scene(meshed(element, angle)))

    return make


def points_again(grid, cells, local):
    """Map local coordinates of cells back to space: what locate() found, undone."""
    mapped = grid.mesh.mapping().F(local[:, :, None], tind=cells)
    return mapped[:, :, 0].T


@pytest.mark.parametrize("angle", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("element", ELEMENTS)
def test_random_points_are_found(grid, element, angle):
    found = grid(element, angle)
    points = np.random.default_rng(0).uniform([-HALF, -DEPTH], [HALF, 0], (2000, 2))
    cells, local, inside = found.locate(points)
    assert inside.all()
    assert local.min() >= 0 and local.max() <= 1
    np.testing.assert_allclose(points_again(found, cells, local), points, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("element", ELEMENTS)
def test_corners_and_edges_are_found(grid, element, angle):
    """Every vertex, and every middle of an edge of a cell, belongs to some cell."""
    found = grid(element, angle)
    vertices = found.mesh.p.T
    middles = found.mesh.p[:, found.mesh.facets].mean(axis=1).T
    for points in (vertices, middles):
        cells, local, inside = found.locate(points)
        assert inside.all()
        np.testing.assert_allclose(points_again(found, cells, local), points, atol=1e-15)


def test_points_outside_are_told(grid):
    outside = np.array([[0, 1e-6], [0, -DEPTH - 1e-6], [HALF + 1e-6, -0.01], [-0.07, -0.01]])
    cells, local, inside = grid().locate(outside)
    assert not inside.any()
    assert (cells >= 0).all() and (cells < grid().mesh.t.shape[1]).all()
    assert local.min() >= 0 and local.max() <= 1


@pytest.mark.parametrize("element", ELEMENTS)
def test_the_cells_fill_the_tissue(grid, element):
    """Positive areas that add up to 120 mm x 80 mm."""
    mesh = grid(element, 0.3).mesh
    x, z = mesh.p[:, mesh.t]
    following = np.roll(np.arange(len(mesh.t)), -1)
    area = 0.5 * (x * z[following] - x[following] * z).sum(axis=0)
    assert area.min() > 0
    assert area.sum() == pytest.approx(4 * HALF * DEPTH / 2, rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.25, -0.4])
def test_the_mesh_follows_the_path(grid, coarse_scene, angle):
    """Along the planned path the points stay in one column, in the same place of it."""
    path = planned_path(coarse_scene(inclined(angle)))
    assert path.entry == pytest.approx(np.zeros(3), abs=1e-15)
    assert math.atan2(path.direction[0], -path.direction[2]) == pytest.approx(-angle, abs=1e-12)
    assert path.depth == pytest.approx(0.06, abs=1e-12)
    found = grid("quad1", angle)
    along = np.linspace(0, path.depth, 50)[:, None] * path.direction[[0, 2]]
    cells, local, inside = found.locate(along + np.array([1e-4, 0.0]))
    assert inside.all()
    assert len(set(cells % (len(found.lateral[0].at) - 1))) == 1
    np.testing.assert_allclose(local[0], local[0, 0], atol=1e-12)


def test_spacing_at_the_path(coarse_scene):
    scene = coarse_scene()
    across, along, band = spacings(scene)
    assert (across, along) == (2e-3, 4e-3)
    found = build_mesh(scene)
    at = found.lateral[0].at
    fine = np.diff(at)[(at[:-1] >= -band - 1e-12) & (at[1:] <= band + 1e-12)]
    np.testing.assert_allclose(fine, across, rtol=1e-12)
    assert np.diff(at).max() <= 1.2 * 0.1 * DEPTH  # whole steps are fitted into the span
    assert np.diff(found.levels)[found.levels[:-1] > -0.06].max() == pytest.approx(along, rel=0.01)


@given(
    band=st.tuples(st.floats(-0.9, 0.9), st.floats(0.01, 0.5)),
    spacing=st.floats(1e-3, 0.1),
    growth=st.floats(1.01, 4),
    largest=st.floats(0.01, 1),
)
@settings(max_examples=300)
def test_graded_lines(band, spacing, growth, largest):
    """From end to end, rising; neighbours differ by the growth, twice it where steps are fitted."""
    center, half = band
    largest = max(largest, spacing)
    lines = graded(-1.0, 1.0, (center - half, center + half), spacing, growth, largest)
    steps = np.diff(lines)
    assert lines[0] == -1.0 and lines[-1] == 1.0
    assert steps.min() > 0
    neighbours = np.maximum(steps[1:] / steps[:-1], steps[:-1] / steps[1:])
    # a band's own steps, which fit its width, may be longer than the largest beside it
    assert neighbours.max(initial=1.0) <= 2 * max(growth, steps.max() / largest)
    assert steps.max() <= 1.5 * largest * (1 + 1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize(
    ("element", "order"),
    [
        ("quad2", 2),
        ("tri2", 2),
        ("quad1", 1),
        ("tri1", 1),
    ],
)
def test_sampling_reproduces_polynomials(coarse_scene, element, order, angle):
    """Linear fields with every element, quadratic ones with quadratic elements, sheared too."""
    model = TissueModel(coarse_scene(meshed(element, angle)))
    points = np.random.default_rng(2).uniform([-HALF, -DEPTH], [HALF, 0], (500, 2))
    nodes, values, inside = model.shape_functions(points)
    assert inside.all()
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-13)

    def field(x, z):
        linear = 0.3 - 2 * x + 5 * z
        return linear if order == 1 else linear + 40 * x * x - 30 * x * z + 70 * z * z

    found = (values * field(*model.coordinates)[nodes]).sum(axis=1)
    np.testing.assert_allclose(found, field(*points.T), atol=1e-14)


def test_a_path_beside_the_tissue_is_refused(coarse_scene):
    with pytest.raises(SceneError, match=r"base\.position.*beside the tissue"):
        build_mesh(coarse_scene(inclined(0.0, entry=0.07)))


def test_a_path_into_a_side_is_refused(coarse_scene):
    with pytest.raises(SceneError, match=r"base\.orientation.*too close to a side"):
        build_mesh(coarse_scene(inclined(1.0)))
