# SPDX-License-Identifier: Apache-2.0
"""Tiles of neighbouring nodes, whose responses are computed together."""

from __future__ import annotations

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.model import TissueModel


class Tiles:
    """Boxes of equal size and the nodes in them; deeper ones have higher numbers.

    Parameters
    ----------
    model : TissueModel
    size : tuple of float
        Extent of a tile in each direction, m.
    center : ndarray, shape (d,)
        Where the middle of a tile is, m.

    Attributes
    ----------
    of : ndarray of int, shape (nodes,)
        Number of each node's tile.
    count : int
        Number of tiles.
    """

    def __init__(self, model: TissueModel, size: tuple[float, ...], center: Vector) -> None:
        steps = [
            np.floor((x - x0) / extent + 0.5)
            for x, x0, extent in zip(model.coordinates, center, size, strict=True)
        ]
        key = np.zeros(model.nodes)
        for step in (-steps[-1], *steps[:-1]):
            key = key * (step.max() - step.min() + 1) + (step - step.min())
        _, self.of = np.unique(key, return_inverse=True)
        self.count = int(self.of.max()) + 1
        self._order = np.argsort(self.of, kind="stable")
        self._bounds = np.searchsorted(self.of[self._order], np.arange(self.count + 1))

    def touched(self, nodes: Index) -> Index:
        """Return the numbers of the tiles that hold some of the nodes, ascending."""
        return np.asarray(np.unique(self.of[nodes]))

    def members(self, tile: int) -> Index:
        """Return the nodes of a tile."""
        return np.asarray(self._order[self._bounds[tile] : self._bounds[tile + 1]])

    def whole(self, nodes: Index) -> Index:
        """Return all nodes of the tiles that hold some, tile by tile."""
        members = [self.members(int(tile)) for tile in self.touched(nodes)]
        return np.concatenate([np.empty(0, dtype=np.intp), *members])
