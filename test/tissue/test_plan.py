# SPDX-License-Identifier: Apache-2.0
"""The planned path holds all that the protocol touches: no tick of it waits for a solve."""

import pytest

from needle_sim_ros import BaseCommand, Scene, Simulator

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
