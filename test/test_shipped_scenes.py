# SPDX-License-Identifier: Apache-2.0
"""Every scene of the package runs its protocol, coarse; published values where there are any."""

import numpy as np
import pytest

from needle_sim_ros import Scene, Simulator
from needle_sim_ros.benchmark.tips import TIPS, deviation
from needle_sim_ros.benchmark.trajectory import hurried
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.resources import scene_names

PLANE = {"tissue.mesh.spacing_across": 2e-3, "tissue.mesh.spacing_along": 4e-3}
SOLID = {
    "tissue.mesh.spacing_across": 3e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "tissue.mesh.growth": 3.0,
    "solver.track_spacing": 4e-3,
}
COARSE = {
    "gao2016": PLANE | {"solver.track_spacing": 2e-3, "solver.modes": 12},
    "gao2016_steel": PLANE | {"solver.track_spacing": 2e-3, "solver.modes": 12},
    "layered_inclusion": PLANE | {"solver.track_spacing": 2e-3},
    "layered_inclusion_3d": SOLID,
    "bevel_gelatin_22g": SOLID | {"tissue.mesh.largest": 15e-3},
    "biopsy_steel": SOLID | {"tissue.mesh.largest": 15e-3},
    "organ": {},
}
FASTER = 10.0


@pytest.fixture(scope="module")
def runs():
    kept = {}

    def run(name):
        if name not in kept:
            scene = hurried(Scene.load(name, COARSE[name]), FASTER)
            sim, seen = Simulator(scene), []
            for command in protocol_commands(scene.protocol, scene.solver.time_step):
                seen.append(sim.step(command, scene.solver.time_step))
            kept[name] = scene, seen
        return kept[name]

    return run


def test_none_is_missing_here():
    assert set(scene_names()) == set(COARSE)


@pytest.mark.parametrize("name", sorted(COARSE))
def test_protocol(runs, name):
    """Goes as deep as the protocol says but for the dent; forces balance; what comes out rests."""
    scene, seen = runs(name)
    planned = max(-s.position[2] for s in _tips(scene))
    depth = max(o.insertion_depth for o in seen)
    assert 0.85 * planned < depth < 1.05 * planned
    for o in seen[:: len(seen) // 10]:
        total = o.contact_forces.sum(axis=0)
        np.testing.assert_allclose(total * [1, -1, -1], -o.base_force, atol=1e-12)
    if scene.protocol[-1].velocity[2] > 0:
        assert seen[-1].process.value in ("free", "retraction")


def _tips(scene):
    """Undeflected tip after each segment."""
    position = np.array(scene.base.position) - [0, 0, scene.needle.length]
    for segment in scene.protocol:
        position = position + segment.duration * np.array(segment.velocity)
        yield type("Tip", (), {"position": position})


def test_quincke_tip(runs):
    """Fitted to 8.89 +- 0.17 mm at 80 mm (Rand 2016) on the scene's own mesh; coarse, about it."""
    _, seen = runs("bevel_gelatin_22g")
    deepest = max(seen, key=lambda o: o.insertion_depth)
    assert 1e3 * np.linalg.norm(deepest.tip_deflection) == pytest.approx(8.89, abs=2.5)


def test_a_stiff_needle_goes_straighter(runs):
    """Of the two hollow steel needles the one with a third of the deviation bends less."""
    _, bent = runs("bevel_gelatin_22g")
    _, straight = runs("biopsy_steel")
    aside = [max(np.abs(o.tip_deflection).max() for o in seen) for seen in (bent, straight)]
    assert aside[1] < 0.35 * aside[0]


def test_steel_bends_less_than_table_1(runs):
    """A hundred times the modulus: the tip deflects less by far."""
    aside = [
        max(abs(o.tip_deflection[0]) for o in runs(n)[1]) for n in ("gao2016", "gao2016_steel")
    ]
    assert aside[1] < 0.5 * aside[0]


@pytest.mark.parametrize("name", ["layered_inclusion", "layered_inclusion_3d"])
def test_forces_step_at_the_interfaces(runs, name):
    """Fig. 3: the tip bears each tissue's cutting force once it is a bevel length inside."""
    _, seen = runs(name)
    going_in = [o for o in seen if o.process.value == "insertion"]

    def borne(low, high):
        return [o.tip_force for o in going_in if low < o.insertion_depth < high]

    assert borne(0.02, 0.027) == pytest.approx([0.30] * len(borne(0.02, 0.027)), rel=1e-6)
    assert max(borne(0.035, 0.039)) == pytest.approx(0.45, rel=1e-6)
    assert max(borne(0.045, 0.058)) == pytest.approx(0.70, rel=1e-6)
    assert max(o.tip_force for o in seen if o.process.value == "contact") > 0.5


def test_tumour_of_the_organ(runs):
    _, seen = runs("organ")
    assert max(o.tip_force for o in seen if o.insertion_depth > 0.025) == pytest.approx(
        0.70, rel=1e-6
    )


def test_deviation_follows_the_bevel_angle():
    """tan(deviation) = c sin(2 beta): its own angle gives the fit back; 45 deg the most."""
    scene = Scene.load("bevel_gelatin_22g")
    tip = scene.needle.tip
    assert deviation(scene, tip.bevel_angle) == pytest.approx(tip.deviation_angle, rel=1e-12)
    angles = [deviation(scene, beta) for beta in (0.3, 0.785398, 1.2)]
    assert angles[1] > max(angles[0], angles[2])
    assert [t.name for t in TIPS if t.bevel is None] == ["Quincke", "Whitacre"]
