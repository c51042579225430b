# SPDX-License-Identifier: Apache-2.0
"""The plain aim: what one does without a model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.task import Task
from needle_sim_ros.scene import Scene


def plain_aim(scene: Scene, task: Task) -> Insertion:
    """Return the insertion that a planner without a model makes: straight at the target.

    It moves the entry where that may vary, or else leans the needle, or else goes on to
    the target's level.
    """
    straight = Insertion.of(scene)
    target, axis = np.array(task.target), straight.axis
    if "entry" in task.vary:
        depth = target[2] / axis[2]
        entry = target - depth * axis
        aimed = replace(straight, entry=(float(entry[0]), float(entry[1])))
    else:
        start = np.array([*straight.entry, 0.0])
        if "inclination" in task.vary:
            straight = _leaning(straight, target - start)
            axis = straight.axis
        depth = float((target - start) @ axis)
        aimed = straight
    depth = float(depth)
    return replace(aimed, travel=depth, reference=depth, turn_at=depth / 2)


def _leaning(insertion: Insertion, way: Vector) -> Insertion:
    """Lean the needle so that its axis goes a way (3,)."""
    way, a, b = way / np.linalg.norm(way), 0.0, 0.0
    for _ in range(20):  # the two angles nearly separate: a few rounds are exact
        axis = replace(insertion, inclination=(a, b)).axis
        a += math.atan2(way[0], -way[2]) - math.atan2(axis[0], -axis[2])
        b += math.atan2(way[1], -way[2]) - math.atan2(axis[1], -axis[2])
    return replace(insertion, inclination=(a, b))
