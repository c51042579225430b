# SPDX-License-Identifier: Apache-2.0
"""Which nodes the planned path will touch, with room for what steers the needle aside."""

from __future__ import annotations

import math

import numpy as np

from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.mesh import Index, planned_path, spacings, steering
from needle_sim_ros.tissue.model import TissueModel


def plane_points(points: Vector, dimension: int) -> Vector:
    """Put world points (n, 3) into the coordinates of the mesh (n, d)."""
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    return points if dimension == 3 else points[:, [0, 2]]


def touched(scene: Scene, model: TissueModel) -> Index:
    """Return the nodes along the planned path: ticks on it shall wait for no solve."""
    path = planned_path(scene)
    if path.depth <= 0:
        return np.empty(0, dtype=np.intp)
    spacing = scene.solver.track_spacing
    depths = np.arange(0.0, path.depth + 2 * spacing, spacing / 2)
    direction = plane_points(path.direction, scene.dimension)[0]
    center = plane_points(path.entry, scene.dimension)[0] + depths[:, None] * direction
    radius = scene.needle.radius * (1 - 1e-9)
    # to the side to which the bevel steers, with room for what the tissue adds
    tip = scene.needle.tip
    if scene.dimension == 3:
        # less room than in 2D: solves are dear, and the worker foresees what leaves the plan
        places = center[:, None, :] + _swept(scene, 1.5 * math.tan(tip.deviation_angle) * depths)
        return _nodes_at(model, places.reshape(-1, 3))
    drift = 2 * math.tan(tip.deviation_angle) * math.cos(tip.roll) * depths
    start, end = np.minimum(drift, 0.0) - radius, np.maximum(drift, 0.0) + radius
    across = start[:, None] + np.linspace(0.0, 1.0, 13) * (end - start)[:, None]
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    aside = plane_points(turned[:, 0], scene.dimension)[0]
    places = (center[:, None, :] + across[:, :, None] * aside).reshape(-1, len(direction))
    return _nodes_at(model, places)


def _swept(scene: Scene, drift: Vector) -> Vector:
    """Return what a disc sweeps that moves by drifts (n,) to the steered side, (n, k, 3)."""
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    step = 0.5 * spacings(scene)[0]
    moves = np.linspace(0.0, 1.0, 2 + int(np.abs(drift).max() / step))
    # cells of any arrangement begin and end anywhere beside the path
    from_file = scene.tissue.mesh.file is not None
    angles = np.linspace(0.0, 2 * np.pi, 32 if from_file else 8, endpoint=False)
    ring = np.cos(angles)[:, None] * turned[:, 0] + np.sin(angles)[:, None] * turned[:, 1]
    room = scene.solver.track_spacing / 4 if from_file else 0.0
    radii = (scene.needle.radius * (1 - 1e-9) + room) * np.linspace(0.0, 1.0, 9 if from_file else 3)
    disc = (radii[:, None, None] * ring).reshape(-1, 3)
    moved = (drift[:, None] * moves)[:, :, None] * steering(scene)
    return np.asarray((moved[:, :, None, :] + disc).reshape(len(drift), -1, 3))


def _nodes_at(model: TissueModel, places: Vector) -> Index:
    """Return the nodes that displacements at places (n, d) are read from."""
    nodes, values, inside = model.shape_functions(places)
    return np.unique(nodes[inside][np.abs(values[inside]) > 1e-12])
