# SPDX-License-Identifier: Apache-2.0
"""The scaling benchmark on grids small enough for a test."""

import math

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.benchmark import scaling_3d
from needle_sim_ros.benchmark.parts import MANY, MEMBERS, costs
from needle_sim_ros.benchmark.scaling import scaling

SMALL = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 2e-3,
    "protocol": [
        {"duration": 4.0, "velocity": [0.0, 0.0, -0.01]},
        {"duration": 0.4},
        {"duration": 0.8, "velocity": [0.0, 0.0, 0.01]},
    ],
}
COARSE = {
    "tissue.mesh.spacing_across": 4e-3,
    "tissue.mesh.spacing_along": 8e-3,
    "tissue.mesh.growth": 4.0,
    "solver.track_spacing": 8e-3,
}
SOLID = {"small": COARSE, "large": COARSE}


@pytest.fixture(scope="module")
def scene():
    return Scene.load("gao2016", SMALL)


def test_grids(scene):
    seen = []
    result = scaling(
        scene, progress=lambda *where: seen.append(where), sides=(9, 33), sizes_3d=SOLID
    )
    grids = [row for row in result.table if "grid" in row]
    assert [row["nodes"] for row in grids] == [81, 1089]
    assert [row["unknowns"] for row in grids] == [2 * 7 * 8, 2 * 31 * 32]
    assert all(0.2 < row["over_1061_nodes"] < 5 and row["peak_gib"] > 0.03 for row in grids)
    assert result.figures["literal_grid_over_1061_nodes"] is None
    assert result.figures["largest_grid_unknowns"] == grids[-1]["unknowns"]
    assert seen[-1][0] == seen[-1][1]
    track = [row for row in result.table if "track_points" in row]
    assert [row["track_points"] for row in track][:2] == ["0 to 9", "10 to 19"]
    assert sum(row["ticks"] for row in track) == (len(seen) - scaling_3d.ticks()) / 3
    assert result.figures["tick_3d_100k_over_small"] > 0


def test_parts(scene):
    result = costs(scene, repeats=5)
    parts = {row["part"] for row in result.table}
    assert {f"reading {name}" for name in MEMBERS[:-1]} <= parts
    assert f"tick, quasi-static, {MANY} markers" in parts
    assert all(math.isfinite(row["microseconds"]) for row in result.table)
    assert result.figures["unread_markers_over_none"] > 0
