# SPDX-License-Identifier: Apache-2.0
"""Surface and region outlines of a scene's undeformed tissue, as points in space."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.scene import Region, Scene
from needle_sim_ros.tissue.mesh_file import read_tetrahedra

Array = NDArray[np.float64]

_ROUND = 48  # segments of a circle
_ACROSS, _DOWN = 37, 27  # points along the edges of the sampled surface


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles between points of the undeformed tissue.

    Parameters
    ----------
    points : (n, 3) array
        m.
    triangles : (m, 3) int array
        Rows of `points`.
    """

    points: Array
    triangles: NDArray[np.intp]


def tissue_surface(scene: Scene) -> Surface:
    """Return what to show of the tissue: the section in 2D, the top face in 3D, or a mesh's skin.

    Sampled points lie closer together near the needle, which displaces most there.
    """
    if scene.tissue.mesh.file is not None:
        mesh = read_tetrahedra(scene).mesh
        corners = mesh.facets[:, mesh.boundary_facets()]
        used, where = np.unique(corners, return_inverse=True)
        return Surface(mesh.p[:, used].T.copy(), where.reshape(corners.shape).T)
    size = scene.tissue.size
    x = size[0] / 2 * _graded(_ACROSS)
    if scene.dimension == 2:
        z = np.linspace(0.0, -size[1], _DOWN)
        grid = np.stack(np.broadcast_arrays(x[None, :], 0.0, z[:, None]), axis=-1)
    else:
        y = size[1] / 2 * _graded(_ACROSS)
        grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 0.0), axis=-1)
    rows, columns = grid.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    c, d = number[1:, 1:].ravel(), number[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Surface(grid.reshape(-1, 3).astype(float), triangles)


def region_lines(scene: Scene) -> Array:
    """Return the outlines of tissue and regions, undeformed, as segments (n, 2, 3), m.

    Regions that are named cells of a mesh file have none.
    """
    low, high = tissue_box(scene)
    parts = [_box(low, high)] if scene.tissue.mesh.file is None else []
    for region in scene.tissue.regions:
        parts.append(_within(_outline(region, low, high), low, high))
    return np.concatenate([np.zeros((0, 2, 3)), *parts])


def tissue_box(scene: Scene) -> tuple[Array, Array]:
    """Return the lowest and the highest corner of the tissue; in 2D both at y = 0."""
    size = scene.tissue.size
    depth = size[1] if scene.dimension == 3 else 0.0
    half = np.array([size[0] / 2, depth / 2, 0.0])
    return -half - np.array([0.0, 0.0, size[-1]]), half


def _graded(count: int) -> Array:
    t = np.linspace(-1.0, 1.0, count)
    return np.asarray(np.sign(t) * np.abs(t) ** 1.6)


def _box(low: Array, high: Array) -> Array:
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    pairs = [
        (i, j)
        for i, j in itertools.combinations(range(8), 2)
        if (np.array(np.unravel_index(i ^ j, (2, 2, 2))) != 0).sum() == 1
    ]
    return corners[np.array(pairs)]


def _outline(region: Region, low: Array, high: Array) -> Array:
    """Return segments (n, 2, 3) of a region's edges or great circles."""
    center, half = np.array(region.center), np.array(region.size) / 2
    if region.shape == "box":
        return _box(np.maximum(center - half, low), np.minimum(center + half, high))
    if region.shape == "half_space":
        return _plane(center, np.array(region.axis), low, high)
    if region.shape == "ellipsoid":
        axes = np.diag(half)
        circles = [_circle(center, axes[i], axes[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
        return np.concatenate(circles)
    if region.shape == "cylinder":
        return _cylinder(center, np.array(region.axis), half[0], half[2])
    return np.zeros((0, 2, 3))


def _circle(center: Array, a: Array, b: Array) -> Array:
    turn = np.linspace(0.0, 2 * np.pi, _ROUND + 1)[:, None]
    points = center + np.cos(turn) * a + np.sin(turn) * b
    return np.stack([points[:-1], points[1:]], axis=1)


def _cylinder(center: Array, axis: Array, radius: float, half_length: float) -> Array:
    a, b, along = _frame(axis)
    ends = [_circle(center + s * half_length * along, radius * a, radius * b) for s in (-1, 1)]
    rims = [center + radius * side for side in (a, b, -a, -b)]
    # whole lines would be dropped where one end is outside the tissue
    steps = np.linspace(-half_length, half_length, _ROUND + 1)[:, None] * along
    lines = [np.stack([rim + steps[:-1], rim + steps[1:]], axis=1) for rim in rims]
    return np.concatenate([*ends, *lines])


def _frame(axis: Array) -> tuple[Array, Array, Array]:
    """Return two unit vectors across an axis, and the axis as a unit vector."""
    along = axis / np.linalg.norm(axis)
    a = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    a /= np.linalg.norm(a)
    return a, np.cross(along, a), along


def _plane(center: Array, axis: Array, low: Array, high: Array) -> Array:
    """Return where the plane through `center` across `axis` cuts the tissue's box."""
    edges = _box(low, high)
    height = (edges - center) @ axis
    crossed = (height[:, 0] > 0) != (height[:, 1] > 0)
    edges, height = edges[crossed], height[crossed]
    if len(edges) < 2:
        return np.zeros((0, 2, 3))
    share = height[:, :1] / (height[:, :1] - height[:, 1:])
    points = edges[:, 0] + share * (edges[:, 1] - edges[:, 0])
    a, b, _ = _frame(axis)
    offset = points - points.mean(axis=0)
    points = points[np.argsort(np.arctan2(offset @ b, offset @ a))]
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def _within(lines: Array, low: Array, high: Array) -> Array:
    """Keep the segments of which both ends are in the tissue's box."""
    slack = 1e-9 * float(np.abs(high - low).max())
    inside = (lines >= low - slack) & (lines <= high + slack)
    return lines[inside.all(axis=(1, 2))]
