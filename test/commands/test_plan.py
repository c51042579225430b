# SPDX-License-Identifier: Apache-2.0
"""``needle_sim plan``: what it writes, its exit status, what it refuses in one line."""

import json

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.cli import main

PLAN = ["plan", "gao2016", "--vary", "entry"]


def refusal(capsys, *arguments):
    """Return the one line on stderr of a call that has to end with status 2."""
    assert main([*PLAN, *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


def test_writes_protocol_json_and_picture(coarse, tmp_path, capsys):
    """The scene it writes runs, with the target as its last marker."""
    out, scene, plot = tmp_path / "p.json", tmp_path / "p.yaml", tmp_path / "p.png"
    files = ["--json", str(out), "--output", str(scene), "--plot", str(plot)]
    assert main([*PLAN, *coarse, "--target", "2", *files]) == 0
    result = json.loads(out.read_text())
    figures = result["figures"]
    assert figures["miss_m"] <= 1e-4
    assert figures["plain_aim_miss_m"] > 5 * figures["miss_m"]
    assert figures["peak_force_n"] > 0
    assert figures["miss_m"] == figures["verified_miss_m"]
    assert result["figures_of"] == "full model"
    assert result["reachable"] is True
    assert "miss of the plain aim" in capsys.readouterr().out
    assert plot.stat().st_size > 1000
    planned = Scene.load(scene)
    assert planned.markers[-1] == (-0.01, 0.0, -0.04)
    assert result["protocol"] == planned.to_dict()["protocol"]


def test_an_unreachable_target_is_said_with_its_nearest_miss(coarse, tmp_path, capsys):
    """Status 1: the work was done, its verdict is bad."""
    out = tmp_path / "p.json"
    limits = ["--max-deflection", "5e-5", "--no-verify", "--json", str(out)]
    assert main([*PLAN, *coarse, "--target", "0.004,0,-0.03", *limits]) == 1
    assert "not reachable: the nearest miss is" in capsys.readouterr().out
    result = json.loads(out.read_text())
    assert result["reachable"] is False
    assert result["figures"]["miss_m"] > 0


def test_studies_uncertainty_and_refuses_another_version(coarse, tmp_path, capsys):
    given, study, out = tmp_path / "u.json", tmp_path / "s.jsonl", tmp_path / "p.json"
    parameters = {"friction.kinetic": {"value": 20.0, "standard_error": 1.0}}
    given.write_text(json.dumps({"parameters": parameters}))
    options = ["--target", "0.004,0,-0.03", "--no-verify", "--uncertainty", str(given)]
    options += ["--samples", "3", "--workers", "1", "--study", str(study), "--json", str(out)]
    assert main([*PLAN, *coarse, *options]) == 0
    figures = json.loads(out.read_text())["uncertainty"]
    assert figures["samples"] == 3
    assert len(study.read_text().splitlines()) == 4
    assert main([*PLAN, *coarse, *options]) == 0  # nothing is missing
    assert len(study.read_text().splitlines()) == 4
    study.write_text('{"needle_sim_study": 0}\n')
    capsys.readouterr()
    assert "version 0" in refusal(capsys, *coarse, *options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--target", "0,0,0.01"], "above the surface"),
        (["--target", "0.2,0,-0.01"], "outside the tissue"),
        (["--target", "11"], "markers 1 to 10"),
        (["--target", "x"], "marker's number"),
        (["--target", "3", "--keep-out", "liver"], "region of the scene"),
        (
            [
                "--target=0,0,-0.03",
                "--keep-out",
                "{shape: box, center: [0, 0, -0.03], size: [1, 1, 0.01]}",
            ],
            "inside the keep-out region",
        ),
        (["--target", "3", "--max-force", "0.1"], "contradicts"),
        (["--target", "3", "--clearance", "1e-3"], "no region"),
        (["--target", "3", "--vary", "speed"], "--vary"),
        (["--target", "3", "--study", "s.jsonl"], "needs --uncertainty"),
        (["--target", "3", "--tolerance", "0"], "must be > 0"),
    ],
)
def test_bad_input_is_one_line(capsys, arguments, words):
    assert words in refusal(capsys, *arguments)
