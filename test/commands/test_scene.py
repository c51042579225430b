# SPDX-License-Identifier: Apache-2.0
"""``needle_sim scene check``."""

import json

import pytest

from needle_sim_ros.cli import main
from needle_sim_ros.resources import scene_names
from needle_sim_ros.scene import Scene


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_of_the_package_is_valid(name, capsys):
    assert main(["scene", "check", name]) == 0
    assert capsys.readouterr().out.startswith(f"{name}: valid\n")


def test_what_the_scene_is_in_a_few_lines(capsys, tmp_path):
    result = tmp_path / "scene.json"
    change = ["--set", "tissue.youngs_modulus=2e4", "--set", "interaction.puncture.force=0.7"]
    assert main(["scene", "check", "gao2016", *change, "--json", f"{result}"]) == 0
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) < 12
    for words in ("120 × 80 mm", "E 20 kPa", "130 mm long", "puncture 0.7 N", "newmark", "54 s"):
        assert words in printed
    written = json.loads(result.read_text())
    assert written["valid"] is True
    assert Scene.from_dict(written["parameters"]).tissue.youngs_modulus == 2e4
