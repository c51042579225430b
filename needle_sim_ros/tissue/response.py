# SPDX-License-Identifier: Apache-2.0
"""What a tick reads of the tissue: responses of the track points to each other.

Rows are appended as the track grows and never change. A table is a view on a store that it
may share with older and newer tables (snapshots); whoever appends to a store that has
already grown beyond it takes a copy first.
"""

from __future__ import annotations

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.compliance import Footprint, NodalCompliance
from needle_sim_ros.tissue.mesh import Index


class _Store:
    """Arrays with room for rows; `length` rows are taken."""

    def __init__(self, readers: int, d: int, modes: int | None) -> None:
        self.length = 0
        self.static = np.zeros((d, d, 0, 0))
        self.between = self.static if modes is None else np.zeros((d, d, 0, 0))
        self.read = np.zeros((readers, d, 0))
        self.modal = np.zeros((modes or 0, d, 0))

    def with_room(self, count: int) -> _Store:
        """Return this store, or a wider or separate one that holds its first `count` rows."""
        capacity = self.static.shape[-1]
        if self.length == count and count < capacity:
            return self
        size = capacity if count < capacity else max(32, 2 * capacity)
        twin = _Store.__new__(_Store)
        twin.length = count
        twin.static = _padded(self.static, (2, 3), size)
        same = self.between is self.static
        twin.between = twin.static if same else _padded(self.between, (2, 3), size)
        twin.read = _padded(self.read, (2,), size)
        twin.modal = _padded(self.modal, (2,), size)
        return twin


class ResponseTable:
    """Effective compliance between footprints and at the readers; immutable.

    Parameters
    ----------
    compliance : NodalCompliance
    modes : ModalPart, optional
        Lowest modes that reduced dynamics moves; they amend the compliance.

    Attributes
    ----------
    count : int
        Number of rows n.
    """

    def __init__(self, compliance: NodalCompliance, modes: ModalPart | None = None) -> None:
        self.compliance = compliance
        self.modes = modes
        self.count = 0
        self._store = _Store(
            compliance.readers, compliance.dimension, None if modes is None else modes.count
        )
        self.nodes: Index = np.empty(0, dtype=np.intp)
        self.weights = np.empty(0)
        self.starts: Index = np.empty(0, dtype=np.intp)

    def between(self) -> Vector:
        """Displacement component a of row k per force component b on row l, (d, d, n, n)."""
        return self._store.between[:, :, : self.count, : self.count]

    def static(self) -> Vector:
        """The same under static loads, (d, d, n, n)."""
        return self._store.static[:, :, : self.count, : self.count]

    def at_readers(self) -> Vector:
        """Static displacement of the readers per force component b on row l, (r, d, n)."""
        return self._store.read[:, :, : self.count]

    def modal(self) -> Vector:
        """Shapes of the modes at the rows, (modes, d, n)."""
        return self._store.modal[:, :, : self.count]

    def appended(self, footprint: Footprint) -> ResponseTable:
        """Return a table with one more row; the common rows are shared, not copied."""
        row, d = self.count, self.compliance.dimension
        twin = ResponseTable.__new__(ResponseTable)
        twin.compliance, twin.modes, twin.count = self.compliance, self.modes, row + 1
        twin._store = store = self._store.with_room(row)
        twin.nodes = np.concatenate([self.nodes, footprint.nodes])
        twin.weights = np.concatenate([self.weights, footprint.weights])
        twin.starts = np.append(self.starts, len(self.nodes))
        n = store.length = row + 1
        at_nodes, at_readers = self.compliance.response(footprint, twin.nodes)
        for a in range(d):
            spread = at_nodes[a] * twin.weights[:, None]
            rows = np.add.reduceat(spread, twin.starts, axis=0)  # (n, d)
            for b in range(d):
                store.static[b, a, :n, row] = rows[:, b]
                store.static[a, b, row, :n] = rows[:, b]
        own = store.static[:, :, row, row]
        store.static[:, :, row, row] = 0.5 * (own + own.T)
        store.read[:, :, row] = at_readers
        if self.modes is not None:
            store.modal[:, :, row] = shape = self.modes.at(footprint)
            amended = store.modal[:, :, :n] * self.modes.amendment[:, None, None]
            column = np.einsum("iak,ib->abk", amended, shape, optimize=True)
            column += self.modes.residual_share * store.static[:, :, :n, row]
            store.between[:, :, :n, row] = column
            store.between[:, :, row, :n] = column.transpose(1, 0, 2)
        return twin

    def sample(self, field: Vector) -> Vector:
        """Sample a nodal field, shape (nodes, d), at the rows; returns (d, n)."""
        if self.count == 0:
            return np.zeros((field.shape[1], 0))
        spread = field[self.nodes] * self.weights[:, None]
        return np.asarray(np.add.reduceat(spread, self.starts, axis=0).T)

    def spread(self, forces: Vector) -> Vector:
        """Spread forces on the rows, shape (d, n), to all nodes; returns (nodes, d), N."""
        d, total = len(forces), self.compliance.total_nodes
        lengths = np.diff(np.append(self.starts, len(self.nodes)))
        loads = np.empty((total, d))
        for a in range(d):
            each = np.repeat(forces[a], lengths) * self.weights
            loads[:, a] = np.bincount(self.nodes, weights=each, minlength=total)
        return loads


def _padded(array: Vector, axes: tuple[int, ...], size: int) -> Vector:
    shape = [size if axis in axes else n for axis, n in enumerate(array.shape)]
    wider = np.zeros(shape)
    wider[tuple(slice(n) for n in array.shape)] = array
    return wider


class ModalPart:
    """How a set of modes amends the static compliance of a step.

    A mode that moves with Newmark answers a unit modal force with ``dynamic`` within the
    step; the static compliance already contains ``static`` of it, of which the share
    ``residual_share`` is left.

    Parameters
    ----------
    shapes : ndarray, shape (nodes, d, modes)
    dynamic, static : ndarray, shape (modes,)
    residual_share : float
    """

    def __init__(
        self, shapes: Vector, dynamic: Vector, static: Vector, residual_share: float
    ) -> None:
        self.shapes = shapes
        self.count = shapes.shape[2]
        self.residual_share = residual_share
        self.amendment = dynamic - residual_share * static

    def at(self, footprint: Footprint) -> Vector:
        """Return the shapes at a footprint, (modes, d)."""
        return np.einsum("k,kam->ma", footprint.weights, self.shapes[footprint.nodes])
