# SPDX-License-Identifier: Apache-2.0
"""Planning simulators that several tests share."""

import pytest

from needle_sim_ros.planning.planner import Planner
from needle_sim_ros.planning.task import Task

TARGET = (0.004, 0.0, -0.035)


@pytest.fixture(scope="session")
def planning_scene_2d(coarse_scene):
    """gao2016, coarse, 45 mm in."""
    return coarse_scene(
        {"protocol": [{"duration": 18.3333333333333333, "velocity": [0.0, 0.0, -3e-3]}]}
    )


@pytest.fixture(scope="session")
def planner(planning_scene_2d):
    return Planner.towards(planning_scene_2d, Task(TARGET))


@pytest.fixture(scope="session")
def plan(planner):
    """A plan of the entry for the target."""
    return planner.plan(Task(TARGET))
