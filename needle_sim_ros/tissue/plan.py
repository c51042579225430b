# SPDX-License-Identifier: Apache-2.0
"""Which nodes the planned path will touch, with room for what steers the needle aside."""

from __future__ import annotations

import math

import numpy as np

from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.mesh import Index, planned_path, spacings, steering
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.near_field import disc_radius
from needle_sim_ros.tissue.tiles import Tiles

# unknowns whose responses to each other are kept about a path in 3D, 0.4 GB, and how far from
# it, m, the base may move or turn the needle then
_AFFORDED = 7_200
# ... of these the set-up makes so many itself, whole tiles, in some five seconds
_AT_ONCE = 4_500
_ROOM = (1.5e-3, 3.0e-3, 5.0e-3)
# how far aside a needle steers, least and most, in parts of its depth times its deviation
_SWERVE = (0.25, 1.5)


def plane_points(points: Vector, dimension: int) -> Vector:
    """Put world points (n, 3) into the coordinates of the mesh (n, d)."""
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    return points if dimension == 3 else points[:, [0, 2]]


def touched(scene: Scene, model: TissueModel) -> Index:
    """Return the nodes along the planned path: ticks on it shall wait for no solve."""
    if planned_path(scene).depth <= 0:
        return np.empty(0, dtype=np.intp)
    center, depths = _center(scene)
    radius = scene.needle.radius * (1 - 1e-9)
    # to the side to which the bevel steers, with room for what the tissue adds
    tip = scene.needle.tip
    if scene.dimension == 3:
        own = _drift(scene, depths)
        return _about(scene, model, center, own, _least(scene))
    drift = 2 * math.tan(tip.deviation_angle) * math.cos(tip.roll) * depths
    start, end = np.minimum(drift, 0.0) - radius, np.maximum(drift, 0.0) + radius
    across = start[:, None] + np.linspace(0.0, 1.0, 13) * (end - start)[:, None]
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    aside = plane_points(turned[:, 0], scene.dimension)[0]
    places = (center[:, None, :] + across[:, :, None] * aside).reshape(-1, scene.dimension)
    return _nodes_at(model, places)


def prepared(scene: Scene, model: TissueModel, tiles: Tiles) -> tuple[Index, list[Index]]:
    """Return the nodes to prepare before the first tick, and those to prepare beside the ticks.

    The planned path, and what of :func:`beside` is made in seconds; then the rest of that.

    Parameters
    ----------
    scene : Scene
    model : TissueModel
    tiles : Tiles
        Nodes are prepared by whole tiles.
    """
    planned = touched(scene, model)
    groups = beside(scene, model, planned)
    while groups:
        wider = np.union1d(planned, groups[0])
        if model.dimension * len(tiles.whole(wider)) > _AT_ONCE:
            break
        planned = wider
        groups.pop(0)
    return planned, groups


def beside(scene: Scene, model: TissueModel, planned: Index) -> list[Index]:
    """Return the nodes about a planned path in 3D, likeliest first, as many as are afforded.

    A base that is turned before the insertion steers to the other side, one that spins while it
    drives keeps to the middle, one that is moved aside leaves it by as much.

    Parameters
    ----------
    scene : Scene
    model : TissueModel
    planned : ndarray of int
        Nodes of :func:`touched`; none of them is returned again.
    """
    path = planned_path(scene)
    if scene.dimension == 2 or path.depth <= 0:
        return []
    center, depths = _center(scene)
    other, least = -_drift(scene, depths), _least(scene)
    groups: list[Index] = []
    known = planned
    for room in (0.0, *_ROOM):
        if room:
            nodes = _about(scene, model, center, 0.0 * other, room)
        else:
            nodes = _about(scene, model, center, other, least)
        fresh = np.setdiff1d(nodes, known)
        known = np.concatenate([known, fresh])
        if model.dimension * len(known) > _AFFORDED:
            break
        groups.append(fresh)
    return groups


def _center(scene: Scene) -> tuple[Vector, Vector]:
    """Return places down the planned path, (n, d), and their depths, (n,), m."""
    path, spacing = planned_path(scene), scene.solver.track_spacing
    depths = np.arange(0.0, path.depth + 2 * spacing, spacing / 2)
    direction = plane_points(path.direction, scene.dimension)[0]
    entry = plane_points(path.entry, scene.dimension)[0]
    return entry + depths[:, None] * direction, depths


def _drift(scene: Scene, depths: Vector) -> Vector:
    """Return how far to the steered side the needle may be at depths, (n,), m."""
    return np.asarray(_SWERVE[1] * math.tan(scene.needle.tip.deviation_angle) * depths)


def _least(scene: Scene) -> float:
    """Return what is left free about the needle where cells are of any arrangement, m."""
    return 0.0 if scene.tissue.mesh.file is None else scene.solver.track_spacing / 4


def _about(scene: Scene, model: TissueModel, center: Vector, drift: Vector, room: float) -> Index:
    """Return the nodes that a disc touches that goes down the path and drifts to a side.

    Parameters
    ----------
    scene : Scene
    model : TissueModel
    center : ndarray, shape (n, 3)
        Places on the path, m.
    drift : ndarray, shape (n,)
        How far at most the needle may have gone at each to the side to which it steers, m.
    room : float
        How much wider than the needle the disc is, m.
    """
    places = center[:, None, :] + _swept(scene, drift, room)
    return _nodes_at(model, places.reshape(-1, 3))


def _swept(scene: Scene, drift: Vector, room: float) -> Vector:
    """Return what a disc sweeps that moves by drifts (n,) to the steered side, (n, k, 3)."""
    quaternion = np.array(scene.base.orientation)
    turned = rotation_matrix(quaternion / np.linalg.norm(quaternion))
    step = 0.5 * spacings(scene)[0]
    least, most = _SWERVE[0] / _SWERVE[1], 1.0
    moves = np.linspace(least, most, 2 + int(np.abs(drift).max() / step)) if drift.any() else [0.0]
    # cells of any arrangement begin and end anywhere beside the path
    from_file = scene.tissue.mesh.file is not None
    radius = disc_radius(scene) * (1 - 1e-9) + room
    rings = 9 if from_file else max(3, 2 + int(radius / step))
    angles = np.linspace(0.0, 2 * np.pi, 32 if from_file else 4 * rings, endpoint=False)
    ring = np.cos(angles)[:, None] * turned[:, 0] + np.sin(angles)[:, None] * turned[:, 1]
    disc = (radius * np.linspace(0.0, 1.0, rings)[:, None, None] * ring).reshape(-1, 3)
    moved = (drift[:, None] * np.asarray(moves))[:, :, None] * steering(scene)
    return np.asarray((moved[:, :, None, :] + disc).reshape(len(drift), -1, 3))


def _nodes_at(model: TissueModel, places: Vector) -> Index:
    """Return the nodes that displacements at places (n, d) are read from."""
    nodes, values, inside = model.shape_functions(places)
    return np.unique(nodes[inside][np.abs(values[inside]) > 1e-12])
