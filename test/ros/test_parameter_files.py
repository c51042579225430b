# SPDX-License-Identifier: Apache-2.0
"""The parameter files in config/nodes: every key is a parameter, and the node takes them."""

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from needle_sim_ros.scene import Scene

FOLDER = Path(__file__).parents[2] / "config" / "nodes"
COARSE_3D = (
    "tissue.mesh.spacing_across=4e-3; tissue.mesh.spacing_along=8e-3; solver.track_spacing=8e-3;"
    "solver.dynamics=quasi_static; solver.modes=0; markers=[]"
)


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.yaml")), ids=lambda f: f.stem)
def test_the_node_takes_the_file(cell, file):
    given = yaml.safe_load(file.read_text())["needle_sim"]["ros__parameters"]
    if Scene.load(given["scene"]).dimension == 3:
        coarse = COARSE_3D
    else:  # Newmark as in the scene, which allows only rates that its step divides
        coarse = f"{cell.overrides}; solver.dynamics=newmark; solver.modes=20"
    overrides = f"{coarse}; {given.pop('scene_overrides', '')}"
    sim = cell.start(arguments=["--params-file", str(file)], scene_overrides=overrides)
    for name, value in given.items():
        assert sim.get_parameter(name).value == value
    assert cell.step(2)["ticks"] == 2


def test_there_is_one_for_each_use():
    assert {file.stem for file in FOLDER.glob("*.yaml")} == {
        "bevel_gelatin_3d",
        "gao2016_1khz",
        "gao2016_2d",
    }
