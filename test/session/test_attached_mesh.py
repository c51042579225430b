# SPDX-License-Identifier: Apache-2.0
"""A session of a scene with a mesh file replays when the file is gone, or another."""

import runpy

import meshio
import numpy as np
import pytest

from needle_sim_ros.resources import find_mesh
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.experiment import of_session
from needle_sim_ros.session.motion import Motion
from needle_sim_ros.session.reader import read_session
from needle_sim_ros.session.writer import SessionWriter
from needle_sim_ros.simulator import Simulator

DT = 0.05
DOWN = Motion("velocity", (0.0, 0.0, -0.02), (0.0, 0.0, 0.0))


def simulated(scene, count=14):
    sim = Simulator(scene)
    return [sim.step(DOWN.command(), DT) for _ in range(count)]


@pytest.mark.parametrize("later", ["gone", "another"])
def test_the_mesh_travels_with_the_session(tmp_path, later):
    module = runpy.run_path(str(find_mesh("organ.msh").with_name("organ.py")))
    organ = module["organ"]
    organ.__globals__["CELLS"] = (4, 4, 3)
    path = tmp_path / "lump.msh"
    meshio.write(path, organ(), file_format="gmsh22", binary=True)
    changes = {"tissue.mesh.file": str(path), "solver.track_spacing": 12e-3, "tissue.regions": []}
    scene = Scene.load("organ", changes)
    seen = simulated(scene)
    writer = SessionWriter(tmp_path / "session", scene, DT)
    for observation in seen:
        writer.observe(observation, DOWN)
    writer.close()
    path.unlink()
    if later == "another":
        path.write_text("no mesh at all")
    session = read_session(tmp_path / "session")
    assert Scene.from_yaml(session.scene_text) == scene
    again = simulated(session.scene())
    # identification takes the mesh from the session, too, and so does its process
    identified = of_session(session).scene()
    assert identified == session.scene()
    child = Scene.from_yaml(identified.to_yaml())
    assert Simulator(child).unknowns == Simulator(session.scene()).unknowns
    assert seen[-1].insertion_depth > 2e-3
    for one, other in zip(seen, again, strict=True):
        np.testing.assert_array_equal(one.base_force, other.base_force)
        np.testing.assert_array_equal(one.marker_positions, other.marker_positions)


def test_a_session_without_a_mesh_file_has_none(tmp_path):
    scene = Scene.load("gao2016")
    SessionWriter(tmp_path / "session", scene, DT).close()
    session = read_session(tmp_path / "session")
    assert session.mesh is None
    assert session.scene() == scene
