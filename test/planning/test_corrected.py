# SPDX-License-Identifier: Apache-2.0
"""Plans that the full model corrects, and bevels that are turned round on the way."""

import math

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.planning.corrected import plan_verified
from needle_sim_ros.planning.planner import Planner
from needle_sim_ros.planning.task import Limits, Task

TARGET = (0.004, 0.0, -0.035)


def test_a_biased_model_is_corrected_by_the_full_one(planning_scene_2d):
    """A planner whose bevel steers half as much again misses, once, and then hits."""
    task = Task(TARGET)
    steering = 1.5 * planning_scene_2d.needle.tip.deviation_angle
    wrong = planning_scene_2d.with_changes({"needle.tip.deviation_angle": steering})
    planner = Planner.towards(wrong, task)
    planner.scene = planning_scene_2d
    plan = planner.plan(task)
    found = plan_verified(planner, task, plan)
    assert plan.reachable
    assert found.corrections >= 1
    assert found.reachable
    assert found.verified.miss <= task.tolerance
    assert found.plan.rollouts - plan.rollouts <= 16


def test_what_the_full_model_misses_is_not_reachable(planner, plan):
    """Within a tolerance that no correction gets to; the best that was run is kept."""
    found = plan_verified(planner, Task(TARGET, tolerance=1e-9), plan)
    assert not found.reachable
    assert math.isfinite(found.verified.miss)


def test_limits_hold_in_the_full_model(planner, plan):
    limits = Limits(force=0.9 * plan.outcome.peak_force)
    found = plan_verified(planner, Task(TARGET, limits=limits), plan)
    assert not found.reachable


def test_a_bevel_turned_round_once_hits_beside_its_path():
    """Few rollouts, from the circles of the bevel alone."""
    changes = {
        "tissue.mesh.spacing_across": 3e-3,
        "tissue.mesh.spacing_along": 4e-3,
        "solver.track_spacing": 4e-3,
        "markers": [],
    }
    scene = Scene.load("bevel_gelatin_22g", changes)
    task = Task((0.001, -0.001, -0.05), ("roll", "schedule"), tolerance=5e-4)
    plan = Planner.towards(scene, task).plan(task)
    assert plan.reachable
    assert plan.rollouts <= 12
    assert plan.plain.miss > 1e-3
    assert plan.insertion.turn == pytest.approx(math.pi, abs=1.0)
