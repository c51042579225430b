# SPDX-License-Identifier: Apache-2.0
"""The soak's parts at their smallest, with the real node in a process of its own."""

import pytest

pytest.importorskip("rclpy")
from needle_sim_ros.ros.domain import free_domain
from needle_sim_ros.ros.soak.endings import end_nodes
from needle_sim_ros.ros.soak.hostility import provoke


@pytest.fixture
def parameters(coarse_scene, tmp_path):
    scene = coarse_scene({"markers": [[0.0, 0.0, -0.01]]})
    (tmp_path / "scene.yaml").write_text(scene.to_yaml())
    return scene, {"scene": str(tmp_path / "scene.yaml"), "rate": 100.0}


def test_hostile_messages_change_no_bit_of_any_step(parameters, tmp_path):
    scene, given = parameters
    advanced = []
    found = provoke(scene, given, free_domain(), tmp_path / "log", 40, advanced.append)
    assert found.messages >= 40 and sum(advanced) == 40
    assert found.steps == 120
    assert found.changed == 0


def test_killed_and_ended_nodes_leave_sessions_that_are_read(parameters, tmp_path):
    _, given = parameters
    found = end_nodes(given, free_domain(), tmp_path, 1, lambda: None)
    assert len(found.losses) == found.salvaged == 1
    assert found.losses[0] < 0.5
    assert len(found.durations) == found.clean == 1
