# SPDX-License-Identifier: Apache-2.0
"""Studies under uncertain parameters: the distribution, the file, resuming."""

import json

import numpy as np
import pytest

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.parallel import executor
from needle_sim_ros.planning import work
from needle_sim_ros.planning.study import Study, run_study
from needle_sim_ros.planning.uncertainty import Uncertainty

TARGET = (0.004, 0.0, -0.035)
CONTENT = {
    "parameters": {
        "youngs_modulus": {"value": 15e3, "standard_error": 1500.0},
        "friction.kinetic": {"value": 14.0, "standard_error": 2.0},
        "tip.deviation_angle": {"value": 0.02, "standard_error": 0.005},
    }
}


@pytest.fixture
def uncertainty(tmp_path, planning_scene_2d):
    path = tmp_path / "identified.json"
    path.write_text(json.dumps(CONTENT))
    return Uncertainty.load(path, planning_scene_2d)


@pytest.fixture
def study(planner, plan, uncertainty):
    work.keep(planner.simulator)
    return Study(planner.simulator.scene, plan.insertion, TARGET, uncertainty)


def run(study, samples, path=None):
    with executor(1) as pool:
        return run_study(study, samples, pool, path)


def test_names_of_identify_are_keys_of_the_scene(uncertainty):
    assert uncertainty.parameters["tissue.youngs_modulus"] == (15e3, 1500.0)
    assert set(uncertainty.parameters) == {
        "tissue.youngs_modulus",
        "interaction.friction.kinetic",
        "needle.tip.deviation_angle",
    }


def test_samples_make_scenes(uncertainty, planning_scene_2d):
    """Static friction never falls below kinetic; moduli stay positive; draws repeat."""
    drawn = [uncertainty.draw(planning_scene_2d, 0, k) for k in range(50)]
    for values in drawn:
        planning_scene_2d.with_changes(values)
    moduli = np.array([values["tissue.youngs_modulus"] for values in drawn])
    assert abs(moduli.mean() - 15e3) < 3 * 1500 / np.sqrt(50)
    assert drawn[7] == uncertainty.draw(planning_scene_2d, 0, 7)


def test_no_uncertainty_gives_the_plan(study, plan):
    sure = {key: (value, 0.0) for key, (value, _) in study.uncertainty.parameters.items()}
    spread = run(Study(study.scene, study.insertion, TARGET, Uncertainty(sure)), 2)
    assert spread.misses == pytest.approx(plan.outcome.miss, abs=2e-6)


def test_an_interrupted_study_resumes(study, tmp_path):
    """The same file in two runs, the second after a line cut short, as in one."""
    path = tmp_path / "study.jsonl"
    run(study, 3, path)
    with path.open("a") as file:
        file.write('{"sample": 3, "miss')
    again = run(study, 6, path)
    lines = path.read_text().splitlines()
    assert json.loads(lines[0])["needle_sim_study"] == 1
    assert [json.loads(line)["sample"] for line in lines[1:]] == [0, 1, 2, 3, 4, 5]
    assert np.array_equal(again.misses, run(study, 6).misses)
    figures = again.figures(float(np.median(again.misses)))
    assert figures["hit_probability"] == pytest.approx(0.5)
    before = path.read_bytes()
    run(study, 6, path)  # nothing is missing
    assert path.read_bytes() == before


def test_a_study_on_a_dask_cluster_finds_the_same(study, tmp_path, dask_address):
    """Its worker prepares the tissue itself, so that sums may round otherwise."""
    path = tmp_path / "there.jsonl"
    with executor(dask=dask_address) as pool:
        there = run_study(study, 6, pool, path)
    lines = [json.loads(line) for line in path.read_text().splitlines()[1:]]
    assert [line["sample"] for line in lines] == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(there.misses, run(study, 6).misses, rtol=1e-6)


def test_files_of_others_are_refused_and_kept(study, tmp_path):
    path = tmp_path / "study.jsonl"
    other = {"needle_sim_study": 1, "of": "another"}
    for text, words in (
        ('{"needle_sim_study": 99}\n', "version 99"),
        ("hello\n", "not a study"),
        (json.dumps(other) + "\n", "another scene"),
    ):
        path.write_text(text)
        with pytest.raises(NeedleSimError, match=words):
            run(study, 1, path)
        assert path.read_text() == text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{}", "parameters"),
        ("no json", "not JSON"),
        ('{"parameters": {"youngs_modulus": 3}}', "standard_error"),
        ('{"parameters": {"colour": {"value": 1, "standard_error": 0}}}', "colour"),
        ('{"parameters": {"cutting.force": {"value": 1, "standard_error": -1}}}', ">= 0"),
    ],
)
def test_what_is_no_uncertainty_is_refused(tmp_path, planning_scene_2d, content, words):
    path = tmp_path / "u.json"
    path.write_text(content)
    with pytest.raises(NeedleSimError, match=words):
        Uncertainty.load(path, planning_scene_2d)
