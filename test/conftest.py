# SPDX-License-Identifier: Apache-2.0
"""Scenes and simulators that several tests share; coarse, so that they are quick."""

import pytest

from needle_sim_ros import Scene, Simulator

# 3440 unknowns: enough for every law, not for the accuracy the benchmarks ask for
COARSE = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 2e-3,
    "solver.dynamics": "quasi_static",
}


@pytest.fixture(scope="session")
def coarse_scene():
    """Make gao2016 on a coarse mesh, with dotted keys changed."""

    def make(changes=None):
        return Scene.load("gao2016", {**COARSE, **(changes or {})})

    return make


@pytest.fixture(scope="session")
def _kept_simulators():
    return {}


@pytest.fixture
def simulator(coarse_scene, _kept_simulators):
    """Make a simulator at its start; equal scenes share their factorised tissue."""

    def make(changes=None):
        scene = coarse_scene(changes)
        if scene not in _kept_simulators:
            _kept_simulators[scene] = Simulator(scene)
        sim = _kept_simulators[scene]
        sim.reset()
        return sim

    return make
