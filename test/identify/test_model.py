# SPDX-License-Identifier: Apache-2.0
"""The similar scene gives what a newly factorised one gives."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, NeedleSimError, SceneError, Simulator
from needle_sim_ros.identify.model import ParametricModel
from needle_sim_ros.identify.parameters import chosen, values_in, with_values

REGION = {
    "name": "lump",
    "shape": "box",
    "center": [0.0, 0.0, -0.02],
    "size": [0.02, 1.0, 0.01],
    "youngs_modulus": 40e3,
    "friction_kinetic": 18.0,
    "friction_static": 19.0,
}
SEEN = ("base_force", "base_torque", "tip_position", "marker_displacements")


@pytest.mark.parametrize("regions", [[], [REGION]], ids=["homogeneous", "with a region"])
def test_another_modulus_needs_no_other_factorisation(coarse_scene, regions):
    scene = coarse_scene({"tissue.regions": regions, "markers": [[-0.003, 0.0, -0.02]]})
    # what would grade the fresh mesh otherwise, base and tip, stays
    values = {"youngs_modulus": 21e3, "friction.kinetic": 12.5, "needle.youngs_modulus": 3e9}
    similar, factor = ParametricModel(scene).at(values)
    fresh = Simulator(with_values(scene, values))
    commands = [BaseCommand(velocity=[0, 0, -3e-3])] * 60 + [BaseCommand()] * 5
    commands += [BaseCommand(velocity=[0, 0, 3e-3])] * 15
    ours, theirs = (sim.rollout(commands, 0.2, SEEN) for sim in (similar, fresh))
    assert np.abs(theirs["base_force"]).max() > 0.5
    for name in SEEN:
        scale = factor if name in ("base_force", "base_torque") else 1.0
        largest = np.abs(theirs[name]).max()
        np.testing.assert_allclose(scale * ours[name], theirs[name], rtol=0, atol=1e-9 * largest)


def test_newmark_keeps_the_tissue_where_only_laws_change(coarse_scene):
    scene = coarse_scene({"solver.dynamics": "newmark", "solver.time_step": 0.05})
    model = ParametricModel(scene)
    simulator, factor = model.at({"cutting.force": 0.2})
    assert factor == 1.0 and simulator._built is model._base._built
    other, factor = model.at({"youngs_modulus": 2e4})
    assert factor == 1.0 and other._built is not model._base._built


def test_a_variant_keeps_the_tissue(simulator, coarse_scene):
    with pytest.raises(SceneError, match=r"needle\.radius"):
        simulator().variant(coarse_scene({"needle.radius": 0.8e-3}))
    with pytest.raises(SceneError, match="tissue"):
        simulator().variant(coarse_scene({"tissue.youngs_modulus": 1e4}))


def test_static_friction_and_puncture_stay_above(coarse_scene):
    scene = with_values(coarse_scene(), {"friction.kinetic": 20.0, "cutting.force": 0.7})
    assert scene.interaction.friction.static == 20.0
    assert scene.interaction.puncture.force == 0.7


def test_parameters_are_named(coarse_scene):
    values = values_in(coarse_scene(), chosen(["youngs_modulus", "base_offset.z"]))
    assert values == {"youngs_modulus": 15e3, "base_offset.z": 0.0}
    with pytest.raises(NeedleSimError, match=r"did you mean friction\.static"):
        chosen(["friction.statik"])
    with pytest.raises(NeedleSimError, match="name each once"):
        chosen(["tip.roll", "tip.roll"])
