# SPDX-License-Identifier: Apache-2.0
"""Scenes and simulators that several tests share; coarse, so that they are quick."""

import pytest
from hypothesis import settings

from needle_sim_ros import BaseCommand, Scene, Simulator

# How long an example takes says more about the machine than about the program.
settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")

# 3440 unknowns: enough for every law, not for the accuracy the benchmarks ask for.
# What is fitted in the scene is pinned here: the tests' numbers follow from these.
COARSE = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 2e-3,
    "solver.dynamics": "quasi_static",
    "solver.modes": 0,
    "interaction": {
        "friction": {"static": 16.0, "kinetic": 14.0, "presliding_stiffness": 1e6},
        "cutting": {"force": 0.3, "relaxation_time": 1.5},
        "puncture": {"force": 0.5},
    },
    "needle.tip": {"bevel_angle": 0.3490658504, "deviation_angle": 0.02},
    "markers": [],
}


@pytest.fixture(scope="session", autouse=True)
def _no_cache():
    """Tests neither read nor fill the user's cache; those about it choose a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEEDLE_SIM_CACHE", "off")
        yield


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


@pytest.fixture(scope="session")
def drive():
    """Move the base with a constant twist; return one observation a tick."""

    def make(sim, duration, velocity=(0, 0, 0), turn=0.0, dt=0.05):
        command = BaseCommand(velocity=velocity, angular_velocity=(0, turn, 0))
        return [sim.step(command, dt) for _ in range(round(duration / dt))]

    return make


@pytest.fixture(scope="session")
def protocol(coarse_scene, drive):
    """The paper's protocol with a straight needle: 10 mm down to the surface, 40 mm in,
    6 s hold, out; observations by name of the part."""
    sim = Simulator(coarse_scene({"needle.tip.deviation_angle": 0.0}))
    return {
        "in": drive(sim, 50 / 3, (0, 0, -3e-3)),
        "hold": drive(sim, 6.0),
        "out": drive(sim, 55 / 3, (0, 0, 3e-3)),
    }


@pytest.fixture(scope="session")
def dask_address():
    """Address of a Dask scheduler with one worker, a process of two threads."""
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 2, "dashboard_address": None}
    with distributed.LocalCluster(processes=True, **options) as cluster:
        assert cluster.scheduler_address.startswith("tcp://")
        yield cluster.scheduler_address
