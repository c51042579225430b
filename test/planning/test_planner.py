# SPDX-License-Identifier: Apache-2.0
"""Plans: they hit, keep to limits, and say when they cannot."""

import math

import numpy as np
import pytest

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.planning.keep_out import clearance, distance, find_region
from needle_sim_ros.planning.task import Limits, Task, check, read_target
from needle_sim_ros.planning.verify import protocol_scene, verify
from needle_sim_ros.scene import Region

TARGET = (0.004, 0.0, -0.035)


def test_hits_where_the_plain_aim_misses(planner, plan):
    assert plan.reachable
    assert plan.outcome.miss < 5e-5
    assert plan.plain.miss > 1e-3


def test_a_full_run_of_the_protocol_hits(planning_scene_2d, plan):
    """The protocol of the plan, in the scene's own model at its own tick."""
    full = verify(protocol_scene(planning_scene_2d, plan.insertion, TARGET))
    assert full.miss < 1.5e-4
    assert full.peak_force == pytest.approx(plan.outcome.peak_force, rel=0.02)


def test_inclination_and_offset_hit_too(planner):
    for vary in (("inclination",), ("offset",)):
        task = Task((0.0035, 0.0, -0.035), (*vary, "entry"))
        found = planner.plan(task)
        assert found.reachable, vary


def test_keeps_clear_of_a_region(planner, plan):
    """A lump on the way is passed by leaning; the clearance asked for is kept."""
    lump = Region("lump", "ellipsoid", (0.0028, 0.0, -0.02), (3e-3, 3e-3, 3e-3))
    assert clearance(plan.outcome.track, [lump], 1e-3) < 0
    limits = Limits(clearance=2e-4, keep_out=(lump,))
    found = planner.plan(Task(TARGET, ("entry", "inclination"), limits))
    assert found.reachable
    assert clearance(found.outcome.track, [lump], 1e-3) > 2e-4 - 2e-8


def test_an_unreachable_target_gives_the_nearest_miss(planner, plan):
    """With less deflection than any way there needs."""
    least = 0.2 * plan.outcome.deflection
    found = planner.plan(Task(TARGET, ("entry",), Limits(deflection=least)))
    assert not found.reachable
    assert found.violations > 0
    assert math.isfinite(found.outcome.miss)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Task((0.0, 0.0, 0.002)), "above the surface"),
        (Task((0.07, 0.0, -0.03)), "outside the tissue"),
        (Task((0.0, 0.0, -0.09)), "outside the tissue"),
        (Task((0.0, 0.01, -0.03)), "y = 0"),
        (Task((math.nan, 0.0, -0.03)), "finite"),
        (Task(TARGET, ("roll",)), "dimension 3"),
        (Task(TARGET, ("angle",)), "entry, inclination"),
        (Task(TARGET, (), Limits()), "may name"),
        (Task(TARGET, ("entry",), Limits(force=0.1)), "contradicts interaction.puncture.force"),
        (Task(TARGET, ("entry",), Limits(clearance=1e-3)), "no region"),
        (Task(TARGET, ("entry",), Limits(force=-1.0)), "must be > 0"),
        (
            Task(
                TARGET,
                ("entry",),
                Limits(keep_out=(Region("r", "box", TARGET, (0.01, 0.01, 0.01)),)),
            ),
            "inside the keep-out region 'r'",
        ),
        (
            Task(
                TARGET,
                ("entry",),
                Limits(
                    clearance=5e-3,
                    keep_out=(Region("r", "box", (0.014, 0.0, -0.035), (0.01, 0.01, 0.01)),),
                ),
            ),
            "contradicts the target",
        ),
    ],
)
def test_what_cannot_be_asked_is_said(planning_scene_2d, task, words):
    with pytest.raises(NeedleSimError, match=words):
        check(task, planning_scene_2d)


def test_targets_are_markers_or_places(coarse_scene):
    scene = coarse_scene({"markers": [[0.001, 0.0, -0.02]]})
    assert read_target("1", scene) == (0.001, 0.0, -0.02)
    assert read_target("0.01,0,-0.05", scene) == (0.01, 0.0, -0.05)
    for text in ("2", "0", "here", "1,2", "0.1,,2"):
        with pytest.raises(NeedleSimError, match="--target"):
            read_target(text, scene)


@pytest.mark.parametrize(
    ("region", "point", "expected"),
    [
        (Region("r", "box", (0, 0, 0), (2, 2, 2)), (2, 0, 0), 1),
        (Region("r", "box", (0, 0, 0), (2, 2, 2)), (0.5, 0, 0), -0.5),
        (Region("r", "box", (0, 0, 0), (2, 2, 2)), (4, 5, 0), 5),
        (Region("r", "half_space", (0, 0, -1), axis=(0, 0, 2)), (3, 3, 2), 3),
        (Region("r", "cylinder", (0, 0, 0), (2, 2, 4)), (3, 0, 0), 2),
        (Region("r", "cylinder", (0, 0, 0), (2, 2, 4)), (0, 0, 3), 1),
        (Region("r", "ellipsoid", (0, 0, 0), (2, 2, 2)), (0, 3, 0), 2),
        (Region("r", "ellipsoid", (0, 0, 0), (2, 4, 6)), (0, 2, 0), 0),
    ],
)
def test_distances(region, point, expected):
    assert distance(np.array([point], dtype=float), region)[0] == pytest.approx(expected, abs=1e-12)


def test_regions_by_name_or_written_out(planning_scene_2d):
    text = "{shape: box, center: [0, 0, -0.03], size: [0.01, 1, 0.01]}"
    region = find_region(text, planning_scene_2d)
    assert region.shape == "box"
    for text in ("lump", "{shape: ball}", "[1, 2]", "{shape: box, size: [0, 1, 1]}"):
        with pytest.raises(NeedleSimError, match="--keep-out"):
            find_region(text, planning_scene_2d)
