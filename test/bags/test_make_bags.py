# SPDX-License-Identifier: Apache-2.0
"""``bags/make_bags.py``: both makers run, coarse and short, and make what they say."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from needle_sim_ros import Simulator
from needle_sim_ros.session.compare import compare
from needle_sim_ros.session.foreign import bag_contents, read_experiment
from needle_sim_ros.session.mapping import read_mapping
from needle_sim_ros.session.reader import read_session
from needle_sim_ros.session.replay import replay, replay_ticks

BAGS = Path(__file__).resolve().parents[2] / "bags"
COARSE = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 4e-3,
    "solver.time_step": 0.02,
    "protocol": [
        {"duration": 1.0},
        {"duration": 3.0, "velocity": [0, 0, -1e-2]},
        {"duration": 0.5},
    ],
}


@pytest.fixture(scope="module")
def make_bags():
    spec = importlib.util.spec_from_file_location("make_bags", BAGS / "make_bags.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_experiment_is_a_simulation_seen_by_a_foreign_system(make_bags, tmp_path, monkeypatch):
    """Read by the shipped mapping: the simulation, its noise, and no bias; some is lost."""
    monkeypatch.setattr(make_bags, "GAP", (2.0, 2.25))
    make_bags.experiment(tmp_path / "bag", COARSE)
    (_, content), *others = bag_contents(tmp_path / "bag")
    assert not others and not content.attachments
    topics = {channel.topic for channel in content.channels.values()}
    assert topics == {"/robot/ee_pose", "/ati/data", "/tracker/beads", "/camera/status"}
    scene = make_bags.Scene.load("gao2016", {**make_bags.TRUTH, **make_bags.FINER, **COARSE})
    mapping = read_mapping(BAGS / "phantom_synthetic.yaml", [])
    experiment = read_experiment(tmp_path / "bag", mapping, scene)
    assert any("bridged" in note for note in experiment.notes)
    force = experiment.measured["force"]
    ticks = round(4.5 / scene.solver.time_step)
    assert 0.85 * ticks < len(force.time) < ticks
    experiment_scene = experiment.scene(scene)
    done = replay(experiment.about, Simulator(experiment_scene), experiment.ticks())
    simulated = np.array(
        [
            np.interp(force.time, experiment.ends[1:], component)
            for component in done.series.base_force.T
        ]
    ).T
    apart = (force.values - simulated)[:, [0, 2]]
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(make_bags.FORCE_NOISE, rel=0.25)
    assert abs(apart.mean()) < make_bags.FORCE_NOISE / 3


def test_the_steering_session_replays_to_the_bit(make_bags, tmp_path, monkeypatch):
    """Half as fine as the shipped one, and shorter; turned on the way."""
    quick = {
        "tissue.mesh.spacing_across": 6e-3,
        "solver.time_step": 0.1,
        "protocol": [
            {"duration": 2.0, "velocity": [0, 0, -1e-2]},
            {"duration": 1.0, "angular_velocity": [0, 0, np.pi]},
            {"duration": 2.0, "velocity": [0, 0, -1e-2]},
        ],
    }
    monkeypatch.setattr(make_bags, "STEERING", {**make_bags.STEERING, **quick})
    make_bags.steering(tmp_path / "bag")
    session = read_session(tmp_path / "bag")
    assert session.complete and len(session.series) == 50
    done = replay(session.metadata, Simulator(session.scene()), replay_ticks(session))
    differences, compared = compare(session.series, done.series)
    assert compared == 50 and len(differences) == 13
    assert all(difference.max_abs == 0 for difference in differences.values())
    assert session.series.insertion_depth[-1] > 0.03
