# SPDX-License-Identifier: Apache-2.0
"""A real run to draw: gao2016, coarse and ten times as fast."""

from dataclasses import dataclass

import numpy as np
import pytest

from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.run import InsertionEnd, Run, run
from needle_sim_ros.simulator import Simulator
from needle_sim_ros.view.section import Section, take_section

COARSE = {
    "solver.dynamics": "quasi_static",
    "solver.time_step": 0.02,
    "solver.track_spacing": 4e-3,
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "markers": [[x, 0.0, z] for z in (-0.01, -0.04, -0.07) for x in (-0.015, -0.005, 0.005)],
    "protocol": [
        {"duration": 2.335, "velocity": [0, 0, -0.03]},
        {"duration": 2.0},
        {"duration": 2.335, "velocity": [0, 0, 0.03]},
    ],
}


@dataclass(frozen=True)
class Drawn:
    """A run, and the section at the end of its insertion."""

    scene: Scene
    sim: Simulator
    run: Run
    section: Section


@pytest.fixture(scope="session")
def drawn() -> Drawn:
    scene = Scene.load("gao2016", COARSE)
    sim = Simulator(scene)
    end = InsertionEnd(sim)
    step = scene.solver.time_step
    done = run(sim, protocol_commands(scene.protocol, step), step, watchers=[end])
    sim.restore(end.snapshot)
    assert np.isfinite(done.series.base_force).all()
    return Drawn(scene, sim, done, take_section(sim, sim.observe()))
