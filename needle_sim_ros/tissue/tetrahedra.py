# SPDX-License-Identifier: Apache-2.0
"""Quadratic tetrahedra of any arrangement, and what finds points in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.mesh import Index

_SLACK = 1e-9  # of a cell, that a point on its face may lie outside


@dataclass(frozen=True)
class Tetrahedra:
    """A mesh with straight edges, as :class:`~needle_sim_ros.tissue.mesh.TissueMesh` is used.

    Attributes
    ----------
    mesh : skfem.MeshTet
        In the tissue frame, m.
    tags : dict of str to ndarray of bool, shape (cells,)
        Cells of each named region.
    fixed : ndarray of int
        Facets of the surface that are held.
    """

    mesh: skfem.MeshTet
    tags: dict[str, NDArray[np.bool_]]
    fixed: Index

    quadrilateral = False

    def locate(self, points: Vector) -> tuple[Index, Vector, NDArray[np.bool_]]:
        """Find the cells of points.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            m.

        Returns
        -------
        cells : ndarray of int, shape (n,)
        local : ndarray, shape (3, n)
            Local coordinates, clipped to the cell.
        inside : ndarray of bool, shape (n,)
            False outside the tissue (cell and local are then of a near cell).
        """
        starts, members = self._bins
        box = self._box_of(points)
        counts = starts[box + 1] - starts[box]
        first = np.cumsum(counts) - counts
        owner = np.repeat(np.arange(len(points)), counts)
        cells = members[np.arange(counts.sum()) - first[owner] + starts[box[owner]]]
        corner, inverse = self._maps
        local = np.einsum("nij,nj->ni", inverse[cells], points[owner] - corner[cells])
        depth = np.minimum(local.min(axis=1), 1.0 - local.sum(axis=1))
        best = np.full(len(points), -np.inf)
        np.maximum.at(best, owner, depth)
        found = np.zeros(len(points), dtype=np.intp)
        hit = np.flatnonzero(depth == best[owner])[::-1]
        found[owner[hit]] = cells[hit]  # of equals the first
        inside = best >= -_SLACK
        if not inside.all():
            found[~inside] = self._nearest.query(points[~inside])[1]
        place = np.einsum("nij,nj->ni", inverse[found], points - corner[found])
        place = np.clip(place, 0.0, 1.0)
        place /= np.maximum(place.sum(axis=1, keepdims=True), 1.0)
        return found, place.T, inside

    def tagged(self, name: str, points: Vector) -> NDArray[np.bool_]:
        """Tell which points, shape (3, ...), lie in cells of a named region."""
        cells, _, inside = self.locate(points.reshape(3, -1).T)
        return np.asarray((self.tags[name][cells] & inside).reshape(points.shape[1:]))

    @cached_property
    def _maps(self) -> tuple[Vector, Vector]:
        corners = self.mesh.p[:, self.mesh.t]  # (3, 4, cells)
        edges = corners[:, 1:] - corners[:, :1]
        return corners[:, 0].T, np.linalg.inv(np.moveaxis(edges, 2, 0))

    @cached_property
    def _nearest(self) -> cKDTree:
        return cKDTree(self.mesh.p[:, self.mesh.t].mean(axis=1).T)

    @cached_property
    def _grid(self) -> tuple[Vector, Vector, Index]:
        low, high = self.mesh.p.min(axis=1), self.mesh.p.max(axis=1)
        # some boxes for each cell: few candidates for a point
        size = (np.prod(high - low) / (16 * self.mesh.t.shape[1])) ** (1 / 3)
        shape = np.maximum(np.ceil((high - low) / size), 1).astype(np.intp)
        return low, (high - low) / shape, shape

    def _box_of(self, points: Vector) -> Index:
        low, size, shape = self._grid
        place = np.clip(np.floor((points - low) / size), 0, shape - 1).astype(np.intp)
        return np.asarray(np.ravel_multi_index(tuple(place.T), tuple(shape)), dtype=np.intp)

    @cached_property
    def _bins(self) -> tuple[Index, Index]:
        """For each box the cells whose bounding boxes meet it: starts (boxes + 1,), cells."""
        low, size, shape = self._grid
        corners = self.mesh.p[:, self.mesh.t]
        slack = 1e-6 * size[:, None]
        first, last = (
            np.clip(np.floor((c - low[:, None]) / size[:, None]), 0, shape[:, None] - 1).astype(int)
            for c in (corners.min(axis=1) - slack, corners.max(axis=1) + slack)
        )
        spans = last - first + 1
        counts = spans.prod(axis=0)
        cell = np.repeat(np.arange(corners.shape[2]), counts)
        turn = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        i, rest = turn % spans[0, cell], turn // spans[0, cell]
        j, k = rest % spans[1, cell], rest // spans[1, cell]
        box = np.ravel_multi_index(tuple(first[:, cell] + np.array([i, j, k])), tuple(shape))
        order = np.argsort(box, kind="stable")
        starts = np.searchsorted(box[order], np.arange(shape.prod() + 1))
        return starts, cell[order]
