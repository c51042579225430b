# SPDX-License-Identifier: Apache-2.0
"""Regions that the needle has to keep out of, and how far points are from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import yaml

from needle_sim_ros.errors import NeedleSimError, SceneError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Region, Scene
from needle_sim_ros.schema import build


def find_region(text: str, scene: Scene) -> Region:
    """Return a region by its name in the scene, or written out as YAML.

    Raises
    ------
    NeedleSimError
        When it is neither.
    """
    names = {region.name: region for region in scene.tissue.regions}
    if text in names:
        return names[text]
    known = ", ".join(names) or "none"
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError:
        data = None
    if not isinstance(data, dict):
        raise NeedleSimError(
            f"--keep-out {text}: must be a region of the scene ({known}) or a mapping like "
            "{shape: ellipsoid, center: [0, 0, -0.03], size: [0.01, 0.01, 0.01]}"
        )
    try:
        return build(Region, {"name": "keep_out", **data})
    except SceneError as error:
        raise NeedleSimError(f"--keep-out {error}") from None


def distance(points: Vector, region: Region) -> Vector:
    """Return the distance of points (n, 3) from a region, (n,), m; negative inside.

    That to an ellipsoid is of first order: exact at its surface, where it matters.
    """
    away = np.asarray(points, dtype=float) - np.array(region.center)
    axis = np.array(region.axis) / np.linalg.norm(region.axis)
    if region.shape == "half_space":
        return np.asarray(away @ axis)
    size = np.array(region.size)
    if region.shape == "box":
        return _outside(np.abs(away) - size / 2)
    if region.shape == "cylinder":
        along = away @ axis
        across = np.linalg.norm(away - np.outer(along, axis), axis=1)
        return _outside(np.column_stack([across - size[0] / 2, np.abs(along) - size[2] / 2]))
    half = size / 2
    scaled = np.linalg.norm(away / half, axis=1)
    slope = np.linalg.norm(away / half**2, axis=1)
    return np.asarray(scaled * (scaled - 1) / np.maximum(slope, 1 / half.max()))


def _outside(beyond: Vector) -> Vector:
    """Return the distance from how far points are beyond each pair of faces, (n, k)."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))


def clearance(track: Vector, regions: Sequence[Region], radius: float) -> float:
    """Return the least distance between a needle along a track (k, 3) and regions, m.

    Both are places in the undeformed tissue: the needle goes through the same tissue
    wherever that has moved to.
    """
    if not regions or len(track) == 0:
        return float("inf")
    parts = np.linspace(0.0, 1.0, 5)[1:, None, None]
    between = (track[:-1] + parts * (track[1:] - track[:-1])).reshape(-1, 3)
    points = np.vstack([track[:1], between])
    return min(float(distance(points, region).min()) for region in regions) - radius
