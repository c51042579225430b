# SPDX-License-Identifier: Apache-2.0
"""``needle_sim identify`` and the replay of measurements, on the synthetic experiment."""

import json
from pathlib import Path

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.cli import main

BAGS = Path(__file__).resolve().parents[2] / "bags"
PHANTOM = [str(BAGS / "phantom_synthetic"), "--mapping", str(BAGS / "phantom_synthetic.yaml")]
COARSE = {
    "solver.dynamics": "quasi_static",
    "solver.modes": 0,
    "solver.time_step": 0.1,
    "solver.track_spacing": 2e-3,
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "interaction.friction.static": 19.5,
    "interaction.friction.kinetic": 14.0,
    "interaction.puncture.force": 0.6,
    "interaction.cutting.relaxation_time": 2.0,
}
SCENE = ["--scene", "gao2016"]
SCENE += [part for k, v in COARSE.items() for part in ("--set", f"{k}={v}")]
# Of bags/make_bags.py. The mesh here is coarser than the one the bag was made with.
TRUTH = {"youngs_modulus": 18e3, "friction.kinetic": 17.0, "cutting.force": 0.38}


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    files = {k: str(folder / f"fit.{k}") for k in ("json", "svg", "yaml")}
    options = ["--parameters", ",".join(TRUTH), "--workers", "1", "--json", files["json"]]
    options += ["--plot", files["svg"], "--output", files["yaml"], "--validate", PHANTOM[0]]
    assert main(["identify", *PHANTOM, *SCENE, *options]) == 0
    return folder


def test_the_phantom_is_identified(identified):
    result = json.loads((identified / "fit.json").read_text())
    for name, truth in TRUTH.items():
        entry = result["parameters"][name]
        assert entry["value"] == pytest.approx(truth, rel=0.06)
        low, high = entry["interval"]
        assert low < entry["value"] < high and entry["standard_error"] > 0
    figures = result["figures"]
    assert figures["force_rms_after_n"] < 0.025 < figures["force_rms_before_n"]
    assert figures["force_rms_validation_above_noise_n"] < 0.03
    assert figures["markers_rms_after_m"] < 1.2e-4
    assert set(result["correlations"]["youngs_modulus"]) == set(TRUTH)


def test_the_fitted_scene_and_the_picture_are_written(identified):
    scene = Scene.load(identified / "fit.yaml")
    assert scene.tissue.youngs_modulus == pytest.approx(18e3, rel=0.06)
    assert len(scene.markers) == 10
    picture = (identified / "fit.svg").read_text()
    assert "measured" in picture and "after" in picture


def test_replay_compares_with_what_was_measured(tmp_path, capsys):
    values = {"tissue.youngs_modulus": 18e3, "interaction.friction.kinetic": 17.0}
    values |= {"interaction.cutting.force": 0.38}
    changed = [part for k, v in values.items() for part in ("--set", f"{k}={v}")]
    out = ["--json", str(tmp_path / "r.json"), "--output", str(tmp_path / "both")]
    out += ["--tolerance", "marker_displacements=2e-3"]
    assert main(["replay", *PHANTOM, *SCENE, *changed, *out]) == 0
    found = json.loads((tmp_path / "r.json").read_text())["channels"]
    assert found["base_force"]["rms"] < 0.03
    assert found["marker_displacements"]["rms"] < 1.5e-4
    assert main(["replay", *PHANTOM, *SCENE, "--tolerance", "base_force=0.01"]) == 1
    assert "beyond the tolerance" in capsys.readouterr().out
    assert main(["plot", str(tmp_path / "both"), "--output", str(tmp_path / "x.svg")]) == 2


def test_two_bags_are_fitted_on_a_dask_cluster(tmp_path, dask_address):
    """All but one parameter at the truth; few ticks."""
    out, known = tmp_path / "fit.json", {"tissue.youngs_modulus": 18e3}
    known |= {"interaction.friction.kinetic": 17.0}
    options = [part for k, v in known.items() for part in ("--set", f"{k}={v}")]
    options += ["--parameters", "cutting.force", "--rate", "2", "--json", str(out)]
    assert main(["identify", PHANTOM[0], *PHANTOM, *SCENE, *options, "--dask", dask_address]) == 0
    found = json.loads(out.read_text())
    assert len(found["bags"]) == 2
    assert found["parameters"]["cutting.force"]["value"] == pytest.approx(0.38, rel=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--parameters", "modulus"], "did you mean youngs_modulus"),
        (["--noise", "force"], "NAME=STANDARD_DEVIATION"),
        (["--set", "base.position=[0,0,0.3]", "--rate", "0"], "must be 0.1 to 10000 Hz"),
        (["--topic", "wrench:=/nothing"], "no topic for wrench"),
        (["--topic", "base_pose:=/ati/data"], "base_pose cannot be"),
        (["--set", "needle.length=0.05", "--set", "protocol=[]"], "never reaches the tissue"),
    ],
)
def test_bad_input_is_one_message_and_status_2(options, message, capsys):
    assert main(["identify", *PHANTOM, *SCENE, "--workers", "1", *options]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_a_bag_of_others_is_replayed_only_with_its_topics_named(capsys):
    assert main(["replay", PHANTOM[0], *SCENE]) == 2
    said = capsys.readouterr().err
    assert "no command topic" in said and "/robot/ee_pose" in said and said.count("\n") == 1


def test_a_scene_that_does_not_fit_the_commands_is_said(tmp_path, capsys):
    """Metres above the tissue, by the transform of the robot's frame."""
    mapping = Path(PHANTOM[2]).read_text().replace("-0.35]", "2.35]")
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(mapping)
    assert main(["replay", PHANTOM[0], "--mapping", str(wrong), *SCENE]) == 2
    assert "the needle never reaches the tissue" in capsys.readouterr().err.splitlines()[-1]
