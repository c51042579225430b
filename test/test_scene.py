# SPDX-License-Identifier: Apache-2.0
"""Scenes: what is refused and how it is said, and the round trip through YAML."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_sim_ros.errors import SceneError
from needle_sim_ros.resources import scene_names
from needle_sim_ros.scene import Scene
from needle_sim_ros.schema import keys


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_load_and_survive_yaml(name):
    scene = Scene.load(name)
    assert scene.name == name
    assert Scene.from_yaml(scene.to_yaml()) == scene
    assert Scene.from_dict(scene.to_dict()) == scene


BAD = [
    ("tissue.youngs_modulus", 0, "> 0"),
    ("tissue.youngs_modulus", -15e3, "> 0"),
    ("tissue.youngs_modulus", "soft", "finite number"),
    ("tissue.youngs_modulus", True, "finite number"),
    ("tissue.youngs_modulus", None, "finite number"),
    ("tissue.poisson_ratio", 0.5, "< 0.5"),
    ("tissue.poisson_ratio", -0.1, ">= 0"),
    ("tissue.poisson_ratio", math.nan, "finite number"),
    ("tissue.density", math.inf, "finite number"),
    ("tissue.size", [0.12], "2 or 3"),
    ("tissue.size", [0.12, -0.08], "> 0"),
    ("tissue.size", [0.12, 0.08, 0.1], "must have 2 entries"),
    ("tissue.size", 0.12, "list"),
    ("tissue.plane", "stretch", "strain, stress"),
    ("tissue.fixed", ["top"], "top"),
    ("tissue.fixed", [], "floats"),
    ("tissue.fixed", ["front"], "2D"),
    ("tissue.mesh.element", "hex", "one of"),
    ("tissue.mesh.growth", 1.0, "> 1"),
    ("needle.length", 0.05, "too short"),
    ("needle.length", 0.069, "too short"),
    ("needle.radius", 0.02, "an eighth"),
    ("needle.radius", "1e", "finite number"),
    ("needle.tip.bevel_angle", 2.0, "<= 1.5708"),
    ("interaction.friction.static", 1.0, "must be >= interaction.friction.kinetic"),
    ("interaction.puncture.force", 0.1, "must be >= interaction.cutting.force"),
    ("interaction.friction", 3, "mapping"),
    ("solver.dynamics", "explicit", "quasi_static, newmark"),
    ("solver.time_step", 0, ">= 1e-05"),
    ("solver.modes", 2.5, "whole number"),
    ("solver.newmark.xi", 0.1, "unstable"),
    ("solver.track_spacing", 0.1, "a quarter of needle.length"),
    ("base.position", [0.0, 0.0, 0.12], "above the surface"),
    ("base.position", [0.0, 0.01, 0.14], "y = 0"),
    ("base.position", [0.2, 0.0, 0.14], "beside the tissue"),
    ("base.orientation", [0, 0, 0, 0], "zero quaternion"),
    ("base.orientation", [0, 0, 0, 1], "point into the tissue"),
    ("protocol", [{"duration": 1.0, "velocity": [0, 0.1, 0]}], "x and z"),
    ("markers", [[0, 0, 0.001]], "inside the tissue"),
    ("markers", [[0, 0]], "3 entries"),
    ("dimension", 4, "2, 3"),
    ("name", "", "text"),
]


@pytest.mark.parametrize(("key", "value", "allowed"), BAD)
def test_the_error_names_key_value_and_what_is_allowed(key, value, allowed):
    with pytest.raises(SceneError) as refusal:
        scene = Scene.load("gao2016", {key: value})
        from needle_sim_ros.simulator import Simulator

        Simulator(scene)  # where a path misses the tissue is found out with the mesh
    assert refusal.value.key.startswith(key.split(".")[0])
    assert allowed in str(refusal.value)
    assert refusal.value.key in str(refusal.value)


@pytest.mark.parametrize(
    "key",
    [
        "tissu",
        "tissue.youngs_modulos",
        "needle.tip.angle",
        "solver.dynamcs",
        "tissue.mesh.x.y",
        "tissue.youngs_modulus.x",
        "protocol.7.duration",
        "protocol.x.duration",
    ],
)
def test_unknown_keys_are_refused_at_every_level(key):
    with pytest.raises(SceneError, match=r"unknown key|does not exist"):
        Scene.load("gao2016", {key: 1.0})


def test_a_near_miss_is_guessed():
    with pytest.raises(SceneError, match="did you mean 'dynamics'"):
        Scene.load("gao2016", {"solver.dynamcs": "newmark"})
    with pytest.raises(SceneError, match="did you mean 'gao2016'"):
        Scene.load("gao2061")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- a",
        "name: [",
        "just text",
        "!!python/object/apply:os.system ['true']",
        "name: !!python/name:os.system",
    ],
)
def test_text_that_is_no_scene(text):
    with pytest.raises(SceneError):
        Scene.from_yaml(text)


def test_files_that_are_no_scene(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        Scene.load(tmp_path / "missing.yaml")
    (tmp_path / "large.yaml").write_text("#" * 1_000_001)
    with pytest.raises(SceneError, match="larger than"):
        Scene.load(tmp_path / "large.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match="cannot be read"):
        Scene.load(tmp_path / "binary.yaml")


def test_numbers_as_yaml_1_1_reads_them():
    """15e3 is text to YAML 1.1; it is a number to us."""
    assert Scene.load("gao2016", {"tissue.youngs_modulus": "15e3"}) == Scene.load("gao2016")


def test_every_key_says_its_unit_or_choices():
    assert {"tissue.youngs_modulus", "protocol[].velocity", "needle.tip.roll"} <= set(keys(Scene))
    assert keys(Scene)["tissue.youngs_modulus"] == "a finite number > 0, in Pa"


@settings(max_examples=60)
@given(
    modulus=st.floats(1e2, 1e7),
    ratio=st.floats(0, 0.4999),
    rigid=st.floats(1e8, 1e12),
    friction=st.floats(0, 100),
    markers=st.lists(
        st.tuples(st.floats(-0.06, 0.06), st.just(0.0), st.floats(-0.08, 0.0)), max_size=5
    ),
    dynamics=st.sampled_from(["quasi_static", "newmark"]),
)
def test_valid_scenes_come_back_equal(modulus, ratio, rigid, friction, markers, dynamics):
    scene = Scene.load(
        "gao2016",
        {
            "tissue.youngs_modulus": modulus,
            "tissue.poisson_ratio": ratio,
            "needle.youngs_modulus": rigid,
            "interaction.friction": {"static": friction, "kinetic": friction / 2},
            "markers": markers,
            "solver.dynamics": dynamics,
        },
    )
    assert Scene.from_yaml(scene.to_yaml()) == scene
    assert hash(scene) == hash(Scene.from_dict(scene.to_dict()))


def test_defaults_follow_from_the_rest():
    """The base starts 10 mm above, all faces but the top are held, I is that of a circle."""
    scene = Scene.from_dict(
        {
            "name": "least",
            "tissue": {"size": [0.1, 0.06], "youngs_modulus": 1e4, "poisson_ratio": 0.45},
            "needle": {"length": 0.1, "radius": 5e-4, "youngs_modulus": 2e11},
        }
    )
    assert scene.base.position == (0.0, 0.0, pytest.approx(0.11))
    assert scene.tissue.fixed == ("left", "right", "bottom")
    circle = math.pi * 5e-4**4 / 4
    assert scene.needle.flexural_rigidity == pytest.approx(2e11 * circle, rel=1e-12)
    assert scene.interaction.puncture.force == scene.interaction.cutting.force


def test_a_segment_is_its_command():
    command = Scene.load("gao2016").protocol[0].command()
    np.testing.assert_array_equal(command.velocity, [0, 0, -3e-3])
    assert command.position is None
