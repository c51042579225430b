# SPDX-License-Identifier: Apache-2.0
"""Displacement per unit force between the few places that a scene reads or loads.

The unit responses of a node do not depend on what the needle did, so they are computed
once, for whole tiles of neighbouring nodes and in a fixed grouping, kept only where
something reads them, and give the same bits whenever they are computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.model import TissueModel


@dataclass(frozen=True)
class Footprint:
    """A mean over a part of the tissue: nodes (k,) and weights (k,) that add up to one.

    The same operator samples displacement and spreads force (Eqs. 18 to 21): K_StoP is
    the weights, K_PtoS their transpose.
    """

    nodes: Index
    weights: Vector


class NodalCompliance:
    """Unit responses of nodes, at nodes and at readers, grown on demand.

    Parameters
    ----------
    model : TissueModel
    factor : Factor
        Of the matrix whose inverse is the compliance: K, or Newmark's effective matrix.
    readers : csr_array, shape (r, free)
        What else reads displacements, e.g. the markers.
    tile : tuple of float
        Extent of a tile of nodes in each direction, m.
    center : ndarray, shape (d,)
        Where the middle of a tile is, m.
    """

    def __init__(
        self,
        model: TissueModel,
        factor: Factor,
        readers: sp.csr_array,
        tile: tuple[float, ...],
        center: Vector,
    ) -> None:
        self._model, self._factor = model, factor
        self.reader_matrix = sp.csr_matrix(readers)
        d = model.dimension
        steps = [
            np.floor((x - x0) / t + 0.5)
            for x, x0, t in zip(model.coordinates, center, tile, strict=True)
        ]
        key = np.zeros(model.nodes)
        for step in steps:
            key = key * (step.max() - step.min() + 1) + (step - step.min())
        _, self._tile_of = np.unique(key, return_inverse=True)
        self._order = np.argsort(self._tile_of, kind="stable")
        self._bounds = np.searchsorted(self._tile_of[self._order], np.arange(key.size + 1))
        self._slot = np.full(model.nodes, -1, dtype=np.intp)
        self._kept = np.empty(0, dtype=np.intp)
        self._blocks = np.zeros((0, 0))
        self._read = np.zeros((readers.shape[0], 0))
        self._d = d

    @property
    def dimension(self) -> int:
        """d."""
        return self._d

    @property
    def readers(self) -> int:
        """Number of rows r that the readers have."""
        return int(self.reader_matrix.shape[0])

    @property
    def total_nodes(self) -> int:
        """Number of nodes of the tissue."""
        return self._model.nodes

    @property
    def kept_nodes(self) -> int:
        """Number of nodes whose responses are kept."""
        return len(self._kept)

    def ensure(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Compute the responses of the tiles of `nodes` that are missing; return how many."""
        tiles = np.unique(self._tile_of[nodes[self._slot[nodes] < 0]])
        for done, tile in enumerate(tiles):
            self._add(self._order[self._bounds[tile] : self._bounds[tile + 1]])
            if progress is not None:
                progress(done + 1, len(tiles))
        return len(tiles)

    def _add(self, nodes: Index) -> None:
        d, model = self._d, self._model
        first, count = len(self._kept), len(nodes)
        unknowns = (d * nodes[:, None] + np.arange(d)).ravel()
        places = model.position_of[unknowns]
        unit = np.zeros((len(model.free), d * count), order="F")
        loaded = np.flatnonzero(places >= 0)
        unit[places[loaded], loaded] = 1.0
        response = self._factor.solve(unit)
        kept = np.concatenate([self._kept, nodes])
        self._reserve(d * len(kept))
        rows = model.position_of[(d * kept[:, None] + np.arange(d)).ravel()]
        block = np.where(rows[:, None] >= 0, response[rows], 0.0)
        low, high = d * first, d * len(kept)
        own = block[low:]
        block[low:] = 0.5 * (own + own.T)
        self._blocks[:high, low:high] = block
        self._blocks[low:high, :low] = block[:low].T
        self._read[:, low:high] = self.reader_matrix @ response
        self._slot[nodes] = np.arange(first, len(kept))
        self._kept = kept

    def _reserve(self, size: int) -> None:
        capacity = self._blocks.shape[0]
        if size <= capacity:
            return
        wider = max(size, 2 * capacity, 256)
        blocks = np.zeros((wider, wider))
        blocks[:capacity, :capacity] = self._blocks
        read = np.zeros((self._read.shape[0], wider))
        read[:, :capacity] = self._read
        self._blocks, self._read = blocks, read

    def response(self, footprint: Footprint) -> tuple[Vector, Vector]:
        """Return the response to unit forces spread by a footprint.

        Returns
        -------
        at_nodes : ndarray, shape (d, kept nodes, d)
            Displacement component b of each kept node per unit force component a.
        at_readers : ndarray, shape (r, d)
            Displacement at the readers per unit force component.
        """
        self.ensure(footprint.nodes)
        d, slots, n = self._d, self._slot[footprint.nodes], self._d * len(self._kept)
        at_nodes = np.empty((d, len(self._kept), d))
        at_readers = np.empty((self._read.shape[0], d))
        # sums along rows, not products of matrices: the same bits wherever a node is kept
        share = footprint.weights[:, None]
        for a in range(d):
            rows = self._blocks[d * slots + a, :n]
            at_nodes[a] = np.add.reduce(rows * share, axis=0).reshape(-1, d)
            columns = self._read[:, d * slots + a]
            at_readers[:, a] = (columns * footprint.weights).sum(axis=1)
        return at_nodes, at_readers

    def slots(self, nodes: Index) -> Index:
        """Return where nodes are among the kept ones."""
        return self._slot[nodes]

    def displacement(self, loaded: Index, loads: Vector, nodes: Index) -> Vector:
        """Return the static displacement of nodes, (k, d), under loads on kept nodes.

        Parameters
        ----------
        loaded : ndarray of int, shape (l,)
            Nodes, which may repeat.
        loads : ndarray, shape (l, d)
            Forces on them, N.
        nodes : ndarray of int, shape (k,)
        """
        self.ensure(nodes)
        d = self._d
        places = (d * self._slot[nodes][:, None] + np.arange(d)).ravel()
        causes = (d * self._slot[loaded][:, None] + np.arange(d)).ravel()
        block = self._blocks[places[:, None], causes[None, :]]
        return np.asarray((block @ loads.ravel()).reshape(-1, d))
