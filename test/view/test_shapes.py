# SPDX-License-Identifier: Apache-2.0
"""Shapes for 3D viewers: where tissue, needle and regions are."""

import numpy as np
import pytest

from needle_sim_ros.scene import Scene
from needle_sim_ros.view.outlines import region_lines, tissue_box, tissue_surface
from needle_sim_ros.view.shapes import FORCE_SCALE, Kind, Shapes


def _area(surface):
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


@pytest.mark.parametrize(
    ("name", "area"),
    [("gao2016", 0.120 * 0.080), ("layered_inclusion_3d", 0.100 * 0.100)],
)
def test_the_surface_covers_the_section_or_the_top(name, area):
    surface = tissue_surface(Scene.load(name))
    assert _area(surface) == pytest.approx(area, rel=1e-9)


def test_the_surface_of_a_mesh_file_is_its_skin():
    surface = tissue_surface(Scene.load("organ"))
    edges = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert set(counts.tolist()) == {2}  # closed


@pytest.mark.parametrize("name", ["layered_inclusion", "layered_inclusion_3d"])
def test_outlines_lie_on_their_regions_and_in_the_tissue(name):
    scene = Scene.load(name)
    lines = region_lines(scene)
    low, high = tissue_box(scene)
    assert (lines >= low - 1e-12).all() and (lines <= high + 1e-12).all()
    points = lines.reshape(-1, 3)
    for region in scene.tissue.regions:
        center, half = np.array(region.center), np.array(region.size) / 2
        if region.shape == "half_space":
            on = np.abs((points - center) @ np.array(region.axis)) < 1e-9
        elif region.shape == "ellipsoid":
            on = np.abs((((points - center) / half) ** 2).sum(axis=1) - 1) < 1e-9
        else:
            on = np.abs(points[:, 2] - (center - half)[2]) < 1e-9
        assert on.sum() >= 4, region.name


def test_a_cylinder_is_outlined():
    region = {"name": "vessel", "shape": "cylinder", "center": [0.0, 0.0, -0.04]}
    region |= {"size": [0.01, 0.01, 0.03], "axis": [0, 1, 0]}
    scene = Scene.load("layered_inclusion_3d", {"tissue.regions": [region]})
    points = region_lines(scene)[12:].reshape(-1, 3) - [0.0, 0.0, -0.04]
    assert np.hypot(points[:, 0], points[:, 2]) == pytest.approx(0.005)
    assert np.abs(points[:, 1]).max() == pytest.approx(0.015)


def test_shapes_are_the_observation(drawn):
    sim = drawn.sim
    seen = sim.observe()
    shapes = {s.name: s for s in Shapes(drawn.scene).of(seen, sim.tissue_displacement)}
    assert list(shapes) == ["tissue", "needle", "track", "markers", "force", "regions"]
    assert np.array_equal(shapes["needle"].points, seen.needle_points)
    assert np.array_equal(shapes["markers"].points, seen.marker_positions)
    inserted = seen.contact_points + sim.tissue_displacement(seen.contact_points)
    assert np.allclose(shapes["track"].points, inserted)
    tail, head = shapes["force"].points
    assert np.linalg.norm(head - tail) == pytest.approx(
        FORCE_SCALE * np.linalg.norm(seen.base_force)
    )
    assert head[2] > tail[2]  # pushing in, the tissue pushes the needle out
    tissue = shapes["tissue"]
    assert tissue.kind is Kind.TRIANGLE_LIST and len(tissue.points) == len(tissue.colours)
    near = np.linalg.norm(tissue.points - seen.tip_position, axis=1).argmin()
    assert tissue.colours[near, 0] > tissue.colours[:, 0].min() + 0.1  # displaced, brighter


def test_what_is_not_there_has_no_points(drawn):
    sim = drawn.sim
    kept = sim.snapshot()
    try:
        seen = sim.reset()
        shapes = {s.name: s for s in Shapes(drawn.scene).of(seen, sim.tissue_displacement)}
    finally:
        sim.restore(kept)
    assert len(shapes["track"].points) == 0 and len(shapes["force"].points) == 0


def test_a_displacement_seen_before_is_that_of_then(drawn):
    sim = drawn.sim
    kept, seen = sim.snapshot(), sim.observe()
    points = [[0.004, 0.0, -0.02], [-0.01, 0.0, -0.05]]
    before = sim.tissue_displacement(points)
    try:
        sim.reset()
        assert np.array_equal(sim.tissue_displacement(points, seen), before)
        assert not sim.tissue_displacement(points).any()
    finally:
        sim.restore(kept)
