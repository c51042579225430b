# SPDX-License-Identifier: Apache-2.0
"""The benchmarks of 3D scenes, on meshes small enough for a test."""

import math

import pytest

from needle_sim_ros import Scene, SceneError
from needle_sim_ros.benchmark import tips as tips_module
from needle_sim_ros.benchmark.accuracy import accuracy
from needle_sim_ros.benchmark.accuracy_3d import levels
from needle_sim_ros.benchmark.scaling_3d import SCENE, SIZES, scaling_3d
from needle_sim_ros.benchmark.speed import speed
from needle_sim_ros.benchmark.tips import TIPS, tips
from needle_sim_ros.benchmark.variants import admissible
from needle_sim_ros.tissue.model import TissueModel

COARSE = {
    "tissue.mesh.spacing_across": 4e-3,
    "tissue.mesh.spacing_along": 8e-3,
    "tissue.mesh.growth": 4.0,
    "solver.track_spacing": 8e-3,
}


def test_accuracy():
    """Levels that are refined together; the next to the finest is nearer to it than the default."""
    sizes = {
        "tissue.mesh.spacing_across": 6e-3,
        "tissue.mesh.spacing_along": 12e-3,
        "solver.track_spacing": 12e-3,
    }
    result = accuracy(Scene.load("layered_inclusion_3d", COARSE | sizes), quick=True)
    figures = {name.rpartition(".")[2]: value for name, value in result.figures.items()}
    assert all(name.startswith("layered_inclusion_3d.quasi_static.") for name in result.figures)
    runs = ["one level coarser", "default", "reference, one level coarser", "reference"]
    assert [row["run"] for row in result.table] == runs
    unknowns = [row["unknowns"] for row in result.table]
    assert unknowns == sorted(unknowns)
    worst = [row["max_error"] for row in result.table]
    assert worst == sorted(worst, reverse=True) and worst[-1] == 0.0
    assert 0 < figures["reference_error"] <= worst[-2]
    assert 0 < figures["max_error"] <= figures["at_equal_times"] == worst[1]
    quantities = ("tip_deflection", "base_force", "friction_force", "markers")
    assert figures["max_error"] == max(figures[name] for name in quantities)


@pytest.mark.parametrize("name", ["layered_inclusion_3d", "bevel_gelatin_22g", "biopsy_steel"])
@pytest.mark.parametrize("quick", [True, False])
def test_scenes_allow_the_levels_that_they_are_compared_with(name, quick):
    scene = Scene.load(name)
    assert all(admissible(scene, changes) for changes in levels(scene, quick).values())


def test_accuracy_refuses_mesh_files():
    with pytest.raises(SceneError, match=r"tissue\.mesh\.file"):
        accuracy(Scene.load("organ"), quick=True)


def test_speed():
    """Beside it the paper's algorithm runs on its own scene in 2D."""
    protocol = [{"duration": 0.7, "velocity": [0.0, 0.0, -0.05]}, {"duration": 0.1}]
    scene = Scene.load("layered_inclusion_3d", COARSE | {"protocol": protocol})
    figures = speed(scene, quick=True).figures
    assert figures["tick_3d_p99_ms"] >= figures["tick_3d_median_ms"] > 0
    assert figures["paper_over_tick_median"] > 1
    assert figures["tick_3d_waits"] == 0
    assert figures["newmark_over_quasi_static"] is None


def test_scaling_is_about_a_scene_as_large_as_it_says():
    *_, large = SIZES.items()
    name, changes = large
    assert name == "over 100 000 unknowns"
    assert len(TissueModel(Scene.load(SCENE, changes)).free) > 100_000


def test_scaling():
    sizes = {"small": COARSE, "large": COARSE | {"tissue.mesh.largest": 6e-3}}
    rows, figures = scaling_3d(lambda: 0.1, lambda: None, sizes)
    assert rows[0]["over_small"] == 1
    assert rows[1]["unknowns"] > 1.5 * rows[0]["unknowns"]
    assert figures["tick_3d_100k_over_small"] == rows[1]["over_small"]


def test_tips(monkeypatch):
    """The fitted tip on a mesh far too coarse; a larger deviation goes further aside."""
    scene = Scene.load("bevel_gelatin_22g")
    changes = {
        "tissue.size": [0.06, 0.06, 0.05],
        "protocol": [{"duration": 7.0, "velocity": [0.0, 0.0, -5e-3]}],
    }
    monkeypatch.setattr(tips_module, "_QUICK", COARSE)
    result = tips(scene.with_changes(changes | {"markers": []}), quick=True)
    found = {row["tip"]: row["found_mm"] for row in result.table}
    assert list(found) == [tip.name for tip in TIPS]
    assert found["Whitacre"] == pytest.approx(0, abs=1e-3)
    assert found["short bevel"] > found["Quincke"] > 0.1
    assert all(math.isfinite(value) for value in result.figures.values())
    with pytest.raises(SceneError, match="bevel_gelatin_22g"):
        tips(Scene.load("gao2016"))
