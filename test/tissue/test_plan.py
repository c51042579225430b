# SPDX-License-Identifier: Apache-2.0
"""The planned path holds all that the protocol touches: no tick of it waits for a solve."""

import time

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Scene, Simulator
from needle_sim_ros.tissue import plan

COARSE = {
    "tissue.mesh.spacing_across": 4e-3,
    "tissue.mesh.spacing_along": 8e-3,
    "tissue.mesh.growth": 4.0,
    "solver.track_spacing": 8e-3,
}


@pytest.mark.parametrize("name", ["bevel_gelatin_22g", "layered_inclusion_3d"])
def test_no_tick_waits_on_the_plan(name):
    """At 20 mm/s, as deep as the protocol goes."""
    scene = Scene.load(name, COARSE)
    depth = sum(
        -part.duration * part.velocity[2] for part in scene.protocol if part.velocity[2] < 0
    )
    sim = Simulator(scene)
    for _ in range(round(depth / 2e-3)):
        sim.step(BaseCommand(velocity=[0, 0, -20e-3]), 0.1)
    assert sim.observe().insertion_depth > 0.8 * depth
    assert sim.statistics.waits == 0


def test_waits_beside_the_plan_are_counted():
    scene = Scene.load("layered_inclusion_3d", COARSE)
    sim = Simulator(scene)
    sim.step(BaseCommand(velocity=[0.03, 0, 0]), 1.0)
    for _ in range(10):
        sim.step(BaseCommand(velocity=[0, 0, -20e-3]), 0.1)
    assert sim.statistics.waits > 0


TURNED = [BaseCommand(angular_velocity=[0, 0, 3.14159])]


@pytest.mark.parametrize(
    ("before", "motion"),
    [
        (TURNED, {"velocity": [0, 0, -20e-3]}),
        ([], {"velocity": [0, 0, -20e-3], "angular_velocity": [0, 0, 6.2832]}),
        ([], {"velocity": [1e-3, 5e-4, -20e-3]}),
    ],
    ids=["turned to the other side before", "spinning", "moved aside"],
)
@pytest.mark.parametrize("name", ["bevel_gelatin_22g", "layered_inclusion_3d"])
def test_no_tick_waits_when_steered_elsewhere(name, before, motion):
    """The set-up prepares what a base that turns, spins or moves by some mm calls for, where that
    is as little as on this mesh."""
    sim = Simulator(Scene.load(name, COARSE))
    assert sim.prepared_beside == 1
    for command in before:
        sim.step(command, 1.0)
    for _ in range(60):
        sim.step(BaseCommand(**motion), 0.05)
    assert sim.observe().insertion_depth > 0.04
    assert sim.statistics.waits == 0


def test_not_a_bit_depends_on_when_it_was_prepared(monkeypatch):
    """Steered off the plan, with what lies beside it prepared by the worker, or by the ticks that
    wait for it."""
    monkeypatch.setattr(plan, "_AT_ONCE", 0)
    seen = []
    for ahead in (True, False):
        sim = Simulator(Scene.load("bevel_gelatin_22g", COARSE))
        if ahead:
            assert sim.prepared_beside == 0
            sim.prepare_beside()
            deadline = time.monotonic() + 60
            while sim.prepared_beside < 1 and time.monotonic() < deadline:
                time.sleep(0.01)
        sim.step(TURNED[0], 1.0)
        for _ in range(20):
            last = sim.step(BaseCommand(velocity=[1e-3, 0, -20e-3]), 0.1)
        seen.append(np.concatenate([last.base_force, last.tip_position]))
        assert (sim.statistics.waits == 0) == ahead
    np.testing.assert_array_equal(*seen)
