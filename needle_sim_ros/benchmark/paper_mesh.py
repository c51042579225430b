# SPDX-License-Identifier: Apache-2.0
"""The paper's mesh: linear triangles on a uniform grid, and where the needle crosses them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Needle nodes closer than this part of a cell count as one: the paper's special condition.
_MERGE = 1e-3


@dataclass(frozen=True)
class Crossing:
    """A needle node P of Fig. 8: where the track crosses the element edge S1 S2.

    Its displacement is (1 - weight) u_S1 + weight u_S2 (Eq. 18, the paper's lambda).
    """

    first: int
    second: int
    weight: float
    arclength: float
    point: Array


class UniformMesh:
    """Rectangle of x-z cells, each cut in two triangles along (i, j) to (i + 1, j + 1).

    Parameters
    ----------
    width, depth : float
        m; the mesh covers |x| <= width / 2, -depth <= z <= 0.
    nodes : int
        About how many nodes; the cells are as square as that allows.

    Attributes
    ----------
    points : ndarray, shape (2, n)
        x and z of the nodes, m; node (i, j) of the grid is number j * columns + i.
    triangles : ndarray, shape (3, m)
    """

    def __init__(self, width: float, depth: float, nodes: int) -> None:
        self.columns = max(2, round(math.sqrt(nodes * width / depth)))
        self.rows = max(2, round(nodes / self.columns))
        self.corner = np.array([-width / 2, -depth])
        self.cell = np.array([width / (self.columns - 1), depth / (self.rows - 1)])
        x = np.linspace(-width / 2, width / 2, self.columns)
        z = np.linspace(-depth, 0.0, self.rows)
        self.points: Array = np.stack([np.tile(x, self.rows), np.repeat(z, self.columns)])
        i, j = np.meshgrid(np.arange(self.columns - 1), np.arange(self.rows - 1))
        origin = (j * self.columns + i).ravel()
        beside, above = origin + 1, origin + self.columns
        self.triangles: Indices = np.hstack(
            [np.stack([origin, beside, above + 1]), np.stack([origin, above + 1, above])]
        )

    def face(self, name: str) -> Indices:
        """Return the nodes of the face ``left``, ``right``, ``bottom`` or ``top``."""
        column, row = np.arange(self.columns), np.arange(self.rows) * self.columns
        faces = {
            "left": row,
            "right": row + self.columns - 1,
            "bottom": column,
            "top": column + (self.rows - 1) * self.columns,
        }
        return faces[name]

    def locate(self, points: ArrayLike) -> tuple[Indices, Array]:
        """Return the triangles' nodes and the barycentric weights of points, (k, 2) to (k, 3)."""
        grid = (np.atleast_2d(np.asarray(points, dtype=float)) - self.corner) / self.cell
        last = np.array([self.columns - 2, self.rows - 2])
        base = np.clip(np.floor(grid), 0, last).astype(np.int64)
        a, b = np.clip(grid - base, 0.0, 1.0).T
        origin = base[:, 1] * self.columns + base[:, 0]
        across = origin + self.columns + 1
        third = np.where(a >= b, origin + 1, origin + self.columns)
        high, low = np.maximum(a, b), np.minimum(a, b)
        return np.stack([origin, across, third], 1), np.stack([1 - high, low, high - low], 1)

    def surface(self, x: float) -> Crossing:
        """Return the point of the top face at `x` as a needle node at arclength 0."""
        place = (x - self.corner[0]) / self.cell[0]
        column = int(np.clip(math.floor(place), 0, self.columns - 2))
        first = (self.rows - 1) * self.columns + column
        return Crossing(
            first, first + 1, float(np.clip(place - column, 0, 1)), 0.0, np.array([x, 0.0])
        )

    def crossings(self, start: Array, end: Array, arclength: float, last: float) -> list[Crossing]:
        """Return the needle nodes that a straight piece of track adds, in order.

        Parameters
        ----------
        start, end : ndarray, shape (2,)
            Material points, m; a crossing exactly at `start` belongs to the piece before.
        arclength, last : float
            Of `start` and of the last needle node so far along the track, m.
        """
        a, b = (start - self.corner) / self.cell, (end - self.corner) / self.cell
        found: list[tuple[float, int]] = []
        # Edges lie where x, z or x - z of the grid is whole.
        for family, form in enumerate(((1.0, 0.0), (0.0, 1.0), (1.0, -1.0))):
            low, high = float(np.dot(form, a)), float(np.dot(form, b))
            if low < high:
                whole = range(math.floor(low) + 1, math.floor(high) + 1)
            else:
                whole = range(math.ceil(low) - 1, math.ceil(high) - 1, -1)
            found += [((value - low) / (high - low), family) for value in whole]
        step = float(np.linalg.norm(end - start))
        nodes: list[Crossing] = []
        for fraction, family in sorted(found):
            here = arclength + fraction * step
            if here - last < _MERGE * min(self.cell):
                continue
            point = start + fraction * (end - start)
            edge = self._edge((point - self.corner) / self.cell, family)
            if edge is not None:
                nodes.append(Crossing(*edge, here, point))
                last = here
        return nodes

    def _edge(self, grid: Array, family: int) -> tuple[int, int, float] | None:
        """Return S1, S2 and the weight of S2 of a point on an edge, None outside the mesh."""
        along = 1 if family == 0 else 0
        place = [round(grid[0]), round(grid[1])]
        if family == 2:
            place = [math.floor(grid[0]), math.floor(grid[1])]
        place[along] = math.floor(grid[along])
        weight = float(grid[along] - place[along])
        if family == 2:
            # Rounding may put the two floors of a point beside a node on different cells.
            place[1] = place[0] - round(grid[0] - grid[1])
        first = place[1] * self.columns + place[0]
        step = (self.columns, 1, self.columns + 1)[family]
        reach = ((0, 1), (1, 0), (1, 1))[family]
        if not (0 <= place[0] <= self.columns - 1 - reach[0]):
            return None
        if not (0 <= place[1] <= self.rows - 1 - reach[1]):
            return None
        return first, first + step, min(max(weight, 0.0), 1.0)
