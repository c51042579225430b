# SPDX-License-Identifier: Apache-2.0
"""The tissue block as a mesh graded to the needle's planned path.

Lines are laid per direction, fine in a band about the path and growing outwards; an
inclined path shears the lines so that they follow it. Such a mesh finds the cell of a
point by bisection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from numpy.typing import NDArray

from needle_sim_ros.errors import SceneError
from needle_sim_ros.geometry import Vector, rotation_matrix
from needle_sim_ros.scene import Scene
from needle_sim_ros.scene_checks import base_poses, half_widths
from needle_sim_ros.tissue.interfaces import fitted, planes

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Path:
    """Planned straight path: entry point (3,), unit direction (3,), depth along it, m."""

    entry: Vector
    direction: Vector
    depth: float


@dataclass(frozen=True)
class Lines:
    """Grid lines of one lateral direction at the surface, and their drift per depth.

    A line stands at ``at + drift * depth``: the drift follows the inclination of the
    path in its neighbourhood and falls to nothing at the sides.
    """

    at: Vector
    drift: Vector

    @cached_property
    def straight(self) -> bool:
        """Whether no line drifts."""
        return not self.drift.any()


@dataclass(frozen=True)
class TissueMesh:
    """A mesh of scikit-fem with what finds points in it.

    Attributes
    ----------
    mesh : skfem.Mesh
        Cells in the coordinates x, z (2D) or x, y, z (3D), m.
    lateral : tuple of Lines
        One per lateral direction.
    levels : ndarray
        Heights of the cell layers, from the bottom (negative) to 0.
    quadrilateral : bool
        Whether a cell is a whole box of the lines (else its triangles).
    """

    mesh: skfem.Mesh
    lateral: tuple[Lines, ...]
    levels: Vector
    quadrilateral: bool

    def locate(self, points: Vector) -> tuple[Index, Vector, NDArray[np.bool_]]:
        """Find the cells of points.

        Parameters
        ----------
        points : ndarray, shape (n, d)
            Points in the coordinates of the mesh, m.

        Returns
        -------
        cells : ndarray of int, shape (n,)
        local : ndarray, shape (d, n)
            Local coordinates in [0, 1].
        inside : ndarray of bool, shape (n,)
            False where the point is outside the tissue (cell and local are then of the
            nearest cell).
        """
        columns, local, inside = self._intervals(points)
        *columns, layer = columns
        *local, up = local
        cells = layer
        for column, lines in zip(reversed(columns), reversed(self.lateral), strict=True):
            cells = cells * (len(lines.at) - 1) + column
        coordinates = np.array([*local, up])
        if not self.quadrilateral:
            cells, coordinates = _triangle(cells, coordinates, *self._widths(columns[0], layer))
        return cells, coordinates, inside

    def places(self, points: Vector) -> Index:
        """Number the lines on which points (n, d) are, doubled, from 0; shape (d, n)."""
        intervals, local, _ = self._intervals(points)
        return np.rint(2 * (np.array(intervals) + np.array(local))).astype(np.intp)

    def _intervals(self, points: Vector) -> tuple[list[Index], list[Vector], NDArray[np.bool_]]:
        """Find between which lines points are, in every direction, heights last."""
        depth = -points[:, -1]
        found = [
            _drifted_interval(lines, points[:, axis], depth)
            for axis, lines in enumerate(self.lateral)
        ]
        found.append(_interval(self.levels, points[:, -1]))
        inside = found[0][2]
        for _, _, within in found[1:]:
            inside = inside & within
        return [index for index, _, _ in found], [part for _, part, _ in found], inside

    def _widths(self, column: Index, layer: Index) -> tuple[Vector, Vector]:
        """Return the widths of boxes at their lower and upper side, m."""
        lines = self.lateral[0]
        at, drift = np.diff(lines.at)[column], np.diff(lines.drift)[column]
        return at - drift * self.levels[layer], at - drift * self.levels[layer + 1]


def _interval(lines: Vector, values: Vector) -> tuple[Index, Vector, NDArray[np.bool_]]:
    low, high = float(lines[0]), float(lines[-1])
    slack = 1e-9 * (high - low)
    inside = values >= low - slack
    inside &= values <= high + slack
    index = lines.searchsorted(values, side="right")
    index -= 1
    np.maximum(index, 0, out=index)
    np.minimum(index, len(lines) - 2, out=index)
    left = lines.take(index)
    part = values - left
    part /= lines[1:].take(index) - left
    np.maximum(part, 0.0, out=part)
    return index, np.minimum(part, 1.0, out=part), inside


def _drifted_interval(
    lines: Lines, values: Vector, depth: Vector
) -> tuple[Index, Vector, NDArray[np.bool_]]:
    if lines.straight:
        return _interval(lines.at, values)
    at = lines.at[None, :] + lines.drift[None, :] * depth[:, None]
    slack = 1e-9 * (lines.at[-1] - lines.at[0])
    inside = (values >= at[:, 0] - slack) & (values <= at[:, -1] + slack)
    index = np.clip((at <= values[:, None]).sum(axis=1) - 1, 0, at.shape[1] - 2)
    rows = np.arange(len(values))
    left, right = at[rows, index], at[rows, index + 1]
    return index, np.clip((values - left) / (right - left), 0.0, 1.0), inside


def _triangle(cells: Index, local: Vector, lower: Vector, upper: Vector) -> tuple[Index, Vector]:
    # the box is split along its diagonal (0,0)-(1,1): below it (0,0)(1,0)(1,1), above the rest;
    # where lines drift apart the box is a trapezoid and its triangles are not its local halves
    part, up = local
    right = part * (lower + up * (upper - lower))  # of the left side, m
    below = right >= up * upper
    x = np.where(below, (right - up * upper) / lower, right / upper)
    y = np.where(below, up, up - x)
    return 2 * cells + np.where(below, 0, 1), np.clip(np.array([x, y]), 0.0, 1.0)


def planned_path(scene: Scene) -> Path:
    """Return the straight line that the undeflected needle follows into the tissue."""
    deepest: tuple[float, Vector, Vector] | None = None
    for position, quaternion in base_poses(scene):
        axis = rotation_matrix(quaternion)[:, 2]
        depth = scene.needle.length + position[2] / axis[2]
        if deepest is None or depth > deepest[0] + 1e-12:
            deepest = (depth, position, axis)
    assert deepest is not None
    depth, position, axis = deepest
    start = rotation_matrix(_unit(np.array(scene.base.orientation)))[:, 2]
    if not scene.protocol or depth <= 0:
        # nothing planned: as deep as the needle and the tissue allow
        position, axis = np.array(scene.base.position), start
        reach = 0.9 * half_widths(scene)[2] / -axis[2]
        depth = min(0.9 * scene.needle.length, reach)
    entry = position - axis * (position[2] / axis[2])
    half_x, half_y, floor = half_widths(scene)
    if abs(entry[0]) > half_x or (scene.dimension == 3 and abs(entry[1]) > half_y):
        raise SceneError(
            "base.position",
            list(scene.base.position or ()),
            f"the needle would meet the surface at x = {entry[0]:g}, y = {entry[1]:g}, "
            "beside the tissue",
        )
    return Path(entry, axis, min(depth, floor / -axis[2]))


def steering(scene: Scene) -> Vector:
    """Return the unit direction, (3,), to which a positive deviation angle steers at the start."""
    turned = rotation_matrix(_unit(np.array(scene.base.orientation)))
    roll = scene.needle.tip.roll
    return np.asarray(math.cos(roll) * turned[:, 0] + math.sin(roll) * turned[:, 1])


def _unit(vector: Vector) -> Vector:
    return np.asarray(vector / np.linalg.norm(vector))


def graded(
    low: float,
    high: float,
    fine: tuple[float, float],
    spacing: float,
    growth: float,
    largest: float,
) -> Vector:
    """Return lines from `low` to `high`: `spacing` apart within `fine`, growing outwards."""
    left, right = max(fine[0], low), min(fine[1], high)
    # no slivers between the band and an end
    left = low if left - low < spacing / 2 else left
    right = high if high - right < spacing / 2 else right
    count = max(1, round((right - left) / spacing))
    lines = list(np.linspace(left, right, count + 1))
    for end, sign in ((high, 1.0), (low, -1.0)):
        edge = right if sign > 0 else left
        steps = _growing(abs(end - edge), (right - left) / count, growth, largest)
        grown = edge + sign * np.cumsum(steps)
        if len(grown):
            grown[-1] = end
        lines = [*lines, *grown] if sign > 0 else [*grown[::-1], *lines]
    return np.array(lines)


def _growing(span: float, first: float, growth: float, largest: float) -> Vector:
    if span <= 1e-12:
        return np.empty(0)
    steps: list[float] = []
    size = first
    while sum(steps) < span * (1 - 1e-12):
        size = min(size * growth, largest)
        steps.append(size)
    return np.array(steps) * (span / sum(steps))


def spacings(scene: Scene) -> tuple[float, float, float]:
    """Return spacing across and along the path and the half width of the fine band, m."""
    mesh, radius = scene.tissue.mesh, scene.needle.radius
    # trilinear hexahedra have no nodes but their corners
    nodes = 1 if scene.dimension == 3 and mesh.element == "quad1" else 2
    along = mesh.spacing_along or nodes * scene.solver.track_spacing
    across = mesh.spacing_across or radius
    return across, along, mesh.band or max(2 * across, 2 * radius)


def build_mesh(scene: Scene) -> TissueMesh:
    """Mesh the tissue of a scene.

    Raises
    ------
    SceneError
        When the planned path leaves no room for the mesh.
    """
    mesh, path = scene.tissue.mesh, planned_path(scene)
    element = str(mesh.element)
    across, along, band = spacings(scene)
    half_x, half_y, floor = half_widths(scene)
    largest = mesh.largest or min(scene.tissue.size) / 8
    depth = path.depth * -path.direction[2]
    faces = planes(scene)
    lateral = []
    for axis, half in ((0, half_x), (1, half_y))[: scene.dimension - 1]:
        if mesh.uniform:
            at = np.linspace(-half, half, max(2, round(2 * half / across)) + 1)
            lateral.append(Lines(at, np.zeros(len(at))))
            continue
        center = float(path.entry[axis])
        before = after = band
        if scene.dimension == 3 and mesh.band is None:
            aside = math.tan(scene.needle.tip.deviation_angle) * path.depth * steering(scene)[axis]
            before, after = band + max(0.0, -aside), band + max(0.0, aside)
        at = graded(
            -half,
            half,
            (center - before, center + after),
            across,
            mesh.growth,
            max(largest, across),
        )
        slope = float(path.direction[axis] / -path.direction[2])
        if slope == 0.0:
            at = fitted(at, faces[axis])
        outward = np.where(
            at < center,
            (at + half) / max(center + half - before, 1e-12),
            (half - at) / max(half - center - after, 1e-12),
        )
        lateral.append(Lines(at, slope * np.clip(outward, 0.0, 1.0)))
        if (np.diff(at + lateral[-1].drift * floor) <= 0).any():
            raise SceneError(
                "base.orientation",
                list(scene.base.orientation),
                "so inclined that the planned path comes too close to a side",
            )
    if mesh.uniform:
        levels = np.linspace(-floor, 0.0, max(2, round(floor / along)) + 1)
    else:
        levels = graded(
            -floor,
            0.0,
            (-min(depth + 3 * along, floor), 0.0),
            along,
            mesh.growth,
            max(largest, along),
        )
        levels = fitted(levels, faces[2])
    if scene.dimension == 3:
        return _hexahedra(lateral[0], lateral[1], levels)
    return _quadrilaterals(lateral[0], levels, element.startswith("quad"))


def _quadrilaterals(lines: Lines, levels: Vector, whole: bool) -> TissueMesh:
    columns, rows = len(lines.at), len(levels)
    x = lines.at[None, :] - lines.drift[None, :] * levels[:, None]
    z = np.repeat(levels[:, None], columns, axis=1)
    points = np.array([x.ravel(), z.ravel()])
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None, :]).ravel()
    box = np.array([corner, corner + 1, corner + columns + 1, corner + columns])
    if whole:
        mesh: skfem.Mesh = skfem.MeshQuad(points, box)
    else:
        halves = np.stack([box[[0, 1, 2]], box[[0, 2, 3]]], axis=2).reshape(3, -1)
        mesh = skfem.MeshTri(points, halves, sort_t=False)
    return TissueMesh(mesh, (lines,), levels, whole)


def _hexahedra(across: Lines, beside: Lines, levels: Vector) -> TissueMesh:
    columns, ranks, rows = len(across.at), len(beside.at), len(levels)
    shape = (rows, ranks, columns)
    x = across.at[None, :] - across.drift[None, :] * levels[:, None]
    y = beside.at[None, :] - beside.drift[None, :] * levels[:, None]
    points = np.array(
        [
            np.broadcast_to(x[:, None, :], shape).ravel(),
            np.broadcast_to(y[:, :, None], shape).ravel(),
            np.broadcast_to(levels[:, None, None], shape).ravel(),
        ]
    )
    number = np.arange(points.shape[1]).reshape(shape)
    # in the order in which the element numbers its corners, so that both share coordinates
    corners = [
        number[k : rows - 1 + k, j : ranks - 1 + j, i : columns - 1 + i].ravel()
        for i, j, k in np.asarray(skfem.ElementHex1.doflocs, dtype=int).tolist()
    ]
    return TissueMesh(skfem.MeshHex(points, np.array(corners)), (across, beside), levels, True)
