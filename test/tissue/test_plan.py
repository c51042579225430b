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
    """The plan holds what a base that turns, spins or moves by some mm calls for."""
    changes = {"tissue.mesh.spacing_along": 4e-3, "solver.track_spacing": 4e-3}
    sim = Simulator(Scene.load(name, COARSE | changes))
    for command in before:
        sim.step(command, 1.0)
    for _ in range(60):
        sim.step(BaseCommand(**motion), 0.05)
    assert sim.observe().insertion_depth > 0.04
    assert sim.statistics.waits == 0
