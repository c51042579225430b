# SPDX-License-Identifier: Apache-2.0
"""Displacement per unit force between the few places that a scene reads or loads.

The unit responses of a node do not depend on what the needle did, so they are computed
once, for whole tiles of neighbouring nodes and in a fixed grouping, and kept only where
something reads them. Between two tiles both solves give the same value but for rounding;
the one of the higher rank counts, so that not a bit depends on what was asked before.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from threading import RLock

import numpy as np
import scipy.sparse as sp

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.products import samples, weighted_rows
from needle_sim_ros.tissue.tiles import Tiles

_ROOM = 256  # nodes off the plan
_MOST_WHOLE = 500_000_000  # bytes of their responses


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
    tiles : Tiles
        Of its nodes.
    """

    def __init__(
        self,
        model: TissueModel,
        factor: Factor,
        readers: sp.csr_array,
        tiles: Tiles,
    ) -> None:
        self._model, self._factor = model, factor
        self.reader_matrix = sp.csr_matrix(readers)
        self.tiles = tiles
        self._rank = np.arange(tiles.count)
        self._slot = np.full(model.nodes, -1, dtype=np.intp)
        self._ready = np.zeros(model.nodes, dtype=bool)  # its responses are there
        self._kept = np.empty(0, dtype=np.intp)
        # by tile: slot of its first node, and how many slots its responses were read at
        self._first = np.full(tiles.count, -1, dtype=np.intp)
        self._read_to = np.zeros(tiles.count, dtype=np.intp)
        self._lacking = False
        self._blocks = np.zeros((0, 0))
        self._read = np.zeros((readers.shape[0], 0))
        self._d = model.dimension
        self._expected: dict[int, Future[Vector]] = {}
        self._worker: ThreadPoolExecutor | None = None
        self._whole: dict[int, Vector] = {}  # responses of tiles off the plan, everywhere
        self._preparing = False
        self._merging = RLock()  # the worker writes responses too
        self.waits = 0  # times that somebody had to wait for a solve

    @property
    def dimension(self) -> int:
        """Number of coordinates d."""
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

    def prepare(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Compute the responses of the tiles on the planned path, before all others.

        Their ranks become the lowest: the solve of a tile off the plan then reads all of
        them, and none has to be solved again for it.
        """
        planned = self._plan(nodes)
        if self._factor.inverts:
            self._invert(planned)
            count = len(planned)
            if progress is not None:
                progress(1, 1)
        else:
            self._preparing = True
            count = self.ensure(nodes, progress)
            self._preparing = False
        self.waits = 0
        return count

    def _plan(self, nodes: Index) -> Index:
        planned = self.tiles.touched(nodes)
        self._rank[planned] -= 2 * len(self._rank)
        return planned

    def _invert(self, planned: Index) -> None:
        """Read the responses of tiles off the inverse between them and the readers."""
        self._take(planned)
        unknowns = self._unknowns(self._kept)
        held = np.flatnonzero(unknowns >= 0)
        last = np.union1d(unknowns[held], self.reader_matrix.indices)
        self._factor.put_last(last)
        block = self._factor.inverse()
        where = np.searchsorted(last, unknowns[held])
        self._blocks[np.ix_(held, held)] = block[np.ix_(where, where)]
        self._read[:, held] = self.reader_matrix[:, last] @ block[:, where]
        self._read_to[planned] = len(self._kept)
        self._ready[self._kept] = True

    def _take(self, planned: Index) -> None:
        for tile in planned:
            self._keep(int(tile))
        # with room for what leaves the plan: to move these numbers takes a tick's time
        self._reserve(self._d * (len(self._kept) + _ROOM))

    def set_aside(self, groups: list[Index]) -> list[int]:
        """Give nodes beside the plan their places before they are computed; return the tiles.

        Their ranks follow those of the plan, in the order of the groups: the solve of each is
        read where it will be wanted, whenever it is made.
        """
        tiles: list[int] = []
        for nodes in groups:
            for tile in self.tiles.touched(nodes):
                if self._first[tile] < 0:
                    self._rank[tile] = len(tiles) - len(self._rank)
                    tiles.append(int(tile))
                    self._keep(int(tile))
        self._reserve(self._d * (len(self._kept) + _ROOM))
        return tiles

    def prepare_tile(self, tile: int) -> None:
        """Compute the responses of a tile that was set aside, unless they are there.

        May run beside the ticks.
        """
        if not self._ready[self.tiles.members(tile)[0]]:
            response = self._responses(tile)
            with self._merging:
                self._merge(tile, response)

    def prepared(self) -> tuple[Vector, Vector]:
        """Return what :meth:`prepare` computed, for :meth:`adopt` of an equal object."""
        size = self._d * len(self._kept)
        return self._blocks[:size, :size], self._read[:, :size]

    def adopt(self, nodes: Index, blocks: Vector, read: Vector) -> bool:
        """Take over what :meth:`prepare` computed for the same nodes; False if it does not fit.

        Nothing is changed where it does not fit, and nothing is factorised.
        """
        size = self._d * len(self.tiles.whole(nodes))
        if blocks.shape != (size, size) or read.shape != (self.readers, size):
            return False
        planned = self._plan(nodes)
        self._take(planned)
        self._blocks[:size, :size], self._read[:, :size] = blocks, read
        self._read_to[planned] = len(self._kept)
        self._ready[self._kept] = True
        if self._factor.inverts:
            unknowns = self._unknowns(self._kept)
            self._factor.put_last(np.union1d(unknowns[unknowns >= 0], self.reader_matrix.indices))
        return True

    def ensure(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Compute the responses of the tiles of `nodes` that are missing; return how many."""
        if self._ready.take(nodes).all():
            return 0
        with self._merging:
            tiles = self.tiles.touched(nodes[~self._ready[nodes]])
            fresh = tiles[self._first[tiles] < 0]
            rank = self._rank[self.tiles.of[self._kept]].max(initial=-2 * len(self._rank))
            self._lacking = self._lacking or bool((self._rank[fresh] < rank).any())
            for tile in fresh:
                self._keep(int(tile))
            self._reserve(self._d * len(self._kept))
            for done, tile in enumerate(tiles):
                self._solve(int(tile))
                if progress is not None:
                    progress(done + 1, len(tiles))
        return len(tiles)

    def expect(self, nodes: Index) -> None:
        """Start computing the responses that nodes will need, beside the ticks.

        What they are does not depend on when they are computed, nor where. What was
        expected before and has not been begun is given up: the needle went elsewhere.
        """
        missing = ~self._ready[nodes]
        if not missing.any() and not self._expected:
            return
        tiles = self.tiles.touched(nodes[missing])
        for tile in set(self._expected).difference(tiles.tolist()):
            if self._expected[tile].cancel():
                del self._expected[tile]
        for tile in tiles:
            if int(tile) not in self._expected:
                self._expected[int(tile)] = self.worker().submit(self._responses, int(tile))

    def worker(self) -> ThreadPoolExecutor:
        """Return the thread that solves beside the ticks."""
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="tissue")
        return self._worker

    def _responses(self, tile: int) -> Vector:
        """Solve for unit forces on a tile's nodes; touches nothing that a tick changes."""
        nodes = self.tiles.members(tile)
        places = self._unknowns(nodes)
        unit = np.zeros((len(self._model.free), self._d * len(nodes)), order="F")
        loaded = np.flatnonzero(places >= 0)
        unit[places[loaded], loaded] = 1.0
        return self._factor.solve(unit)

    def _keep(self, tile: int) -> None:
        nodes, first = self.tiles.members(tile), len(self._kept)
        self._first[tile] = first
        self._slot[nodes] = np.arange(first, first + len(nodes))
        self._kept = np.concatenate([self._kept, nodes])

    def _solve(self, tile: int) -> None:
        """Compute the responses of a tile's nodes at the kept nodes of no higher rank."""
        self._merge(tile, self._response(tile))

    def _merge(self, tile: int, response: Vector) -> None:
        nodes = self.tiles.members(tile)
        slots = np.flatnonzero(self._rank[self.tiles.of[self._kept]] <= self._rank[tile])
        rows = self._unknowns(self._kept[slots])
        block = np.where(rows[:, None] >= 0, response[rows], 0.0)
        places, own = self._places(self._kept[slots]), self._places(nodes)
        low, high = int(own[0]), int(own[-1]) + 1
        itself = (places >= low) & (places < high)
        block[itself] = 0.5 * (block[itself] + block[itself].T)
        self._blocks[places, low:high] = block
        self._blocks[low:high, places] = block.T
        self._read[:, low:high] = self.reader_matrix @ response
        self._read_to[tile] = len(self._kept)
        self._ready[nodes] = True

    def _response(self, tile: int) -> Vector:
        """Return the responses of a tile's nodes everywhere, (free, d k)."""
        if tile in self._whole:
            return self._whole[tile]
        expected = self._expected.pop(tile, None)
        if expected is None or not expected.done():
            self.waits += 1
            if expected is not None and expected.cancel():  # rather now than in its turn
                expected = None
        response = self._responses(tile) if expected is None else expected.result()
        if not self._preparing:
            # it is read again when tiles of lower rank come: without another solve
            self._whole[tile] = response
            while sum(one.nbytes for one in self._whole.values()) > _MOST_WHOLE:
                del self._whole[next(iter(self._whole))]
        return response

    def _complete(self, nodes: Index, others: Index) -> None:
        """Solve tiles again that are to be read at nodes kept after their solve."""
        if not self._lacking:
            return
        one, other = np.meshgrid(self.tiles.touched(nodes), self.tiles.touched(others))
        swap = self._rank[one] > self._rank[other]
        lower, higher = np.where(swap, other, one), np.where(swap, one, other)
        for tile in np.unique(higher[self._first[lower] >= self._read_to[higher]]):
            self._solve(int(tile))

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

    def column(
        self, footprint: Footprint, component: int, at: Index, weights: Vector, starts: Index
    ) -> Vector:
        """Return the displacement (n d,) of other footprints per unit force component on one.

        Parameters
        ----------
        footprint : Footprint
            Over which the force is spread.
        component : int
            Of the force.
        at : ndarray of int, shape (l,)
            Nodes of the others, one after the other.
        weights : ndarray, shape (l,)
        starts : ndarray of int, shape (n,)
            Where each of them begins.
        """
        d, nodes = self._d, footprint.nodes
        self.ensure(nodes)
        self.ensure(at)
        self._complete(nodes, at)
        if len(at) == 0:
            return np.empty(0)
        places = self._slot[at]
        low, high = int(places.min()), int(places.max()) + 1
        rows = d * self._slot[nodes] + component
        moved = weighted_rows(self._blocks, rows, footprint.weights, d * low, d * high)
        return samples(moved, places - low, weights, starts, d)

    def at_readers(self, footprint: Footprint) -> Vector:
        """Return the displacement at the readers, (r, d), per unit force component."""
        self.ensure(footprint.nodes)
        places, count = self._d * self._slot[footprint.nodes], len(self._read)
        columns = [
            weighted_rows(self._read.T, places + a, footprint.weights, 0, count)
            for a in range(self._d)
        ]
        return np.stack(columns, axis=1)

    def _unknowns(self, nodes: Index) -> Index:
        """Return the places of the components of nodes among the free unknowns, -1 if held."""
        wide = self._d * nodes[:, None] + np.arange(self._d)
        return np.asarray(self._model.position_of[wide.ravel()])

    def _places(self, nodes: Index) -> Index:
        return np.asarray((self._d * self._slot[nodes][:, None] + np.arange(self._d)).ravel())
