# SPDX-License-Identifier: Apache-2.0
"""What a tick reads of the tissue: responses of the track points to each other.

Rows are appended as the track grows and never change. A table is a view on a store that it
may share with older and newer tables (snapshots); whoever appends to a store that has
already grown beyond it takes a copy first.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.compliance import Footprint, NodalCompliance
from needle_sim_ros.tissue.mesh import Index
from needle_sim_ros.tissue.products import product, samples, weighted_rows

# components of a unit vector that are not zero, by number
Axis = list[tuple[int, float]]
Axes = tuple[Axis, ...]


class _Store:
    """Arrays with room for rows; `length` rows are taken.

    What is there from the start is written to, so that no tick has to ask for the memory.
    """

    def __init__(self, readers: int, d: int, modes: int | None, room: int, near: bool) -> None:
        self.length = 0
        self.d = d
        size = d * room
        self.residual = np.full((size, size), 0.0)
        self.between = self.residual if modes is None else np.full((size, size), 0.0)
        self.read = np.full((readers, size), 0.0)
        self.modal = np.full((modes or 0, size), 0.0)
        # of `static` and `read`, what the mesh does not show
        self.near = np.full((size, size), 0.0) if near else None
        self.near_read = np.full((readers, size), 0.0) if near else None

    def with_room(self, count: int) -> _Store:
        """Return this store, or a wider or separate one that holds its first `count` rows."""
        capacity, taken = len(self.residual) // self.d, self.d * count
        if self.length == count and count < capacity:
            return self
        size = self.d * (capacity if count < capacity else max(32, 2 * capacity))
        twin = _Store.__new__(_Store)
        twin.length, twin.d = count, self.d
        twin.residual = _widened(self.residual, size, taken, taken)
        same = self.between is self.residual
        twin.between = twin.residual if same else _widened(self.between, size, taken, taken)
        twin.read = _widened(self.read, size, taken)
        twin.modal = _widened(self.modal, size, taken)
        twin.near = None if self.near is None else _widened(self.near, size, taken, taken)
        near = self.near_read
        twin.near_read = None if near is None else _widened(near, size, taken)
        return twin


class Rows(NamedTuple):
    """Footprints of rows, one after the other.

    Attributes
    ----------
    nodes, weights : ndarray, shape (l,)
    starts : ndarray of int, shape (n,)
        Where each footprint begins.
    """

    nodes: Index = np.empty(0, dtype=np.intp)
    weights: Vector = np.empty(0)
    starts: Index = np.empty(0, dtype=np.intp)

    def joined(self, footprint: Footprint) -> Rows:
        """Return these and another one."""
        return Rows(
            np.concatenate([self.nodes, footprint.nodes]),
            np.concatenate([self.weights, footprint.weights]),
            np.append(self.starts, len(self.nodes)),
        )


class ResponseRow(NamedTuple):
    """A row that a table of n rows would get.

    Attributes
    ----------
    rows : Rows
        Of the table, and the new one.
    static : ndarray, shape ((n + 1) d, d)
        Displacement of all rows per force on the new one, m/N.
    at_readers : ndarray, shape (r, d)
    shape : ndarray, shape (modes, d)
    near : ndarray, shape ((n + 1) d, d), or None
        Of `static`, what the mesh does not show.
    near_read : ndarray, shape (r, d), or None
        Of `at_readers` the same.
    """

    rows: Rows
    static: Vector
    at_readers: Vector
    shape: Vector
    near: Vector | None = None
    near_read: Vector | None = None


class Reading(NamedTuple):
    """How a footprint moves under forces on the rows of a table, as far as it is known.

    Attributes
    ----------
    footprint : Footprint
    columns : tuple of ndarray, shape (n d,)
        Static displacement of the rows per unit force on the footprint, m/N, component by
        component; by Maxwell and Betti that of the footprint per force on the rows.
    shape : ndarray, shape (modes, d)
        Shapes of the modes at the footprint, known with the last column.
    """

    footprint: Footprint
    columns: tuple[Vector, ...] = ()
    shape: Vector = np.empty((0, 0))

    def displacement(self, forces: Vector) -> Vector:
        """Return the static displacement, (d,), m, by forces (k, d) on the first k rows, N."""
        flat = forces.ravel()
        return np.array([float(column[: len(flat)] @ flat) for column in self.columns])


class ResponseTable:
    """Effective compliance between footprints and at the readers; immutable.

    Component a of row k is entry d k + a, so arrays (n, d) fit when raveled.

    Parameters
    ----------
    compliance : NodalCompliance
    modes : ModalPart, optional
        Lowest modes that reduced dynamics moves; they amend the compliance.
    room : int
        Rows that will come; there may be more.
    near : bool
        Whether rows have what the mesh does not show.

    Attributes
    ----------
    count : int
        Number of rows n.
    """

    def __init__(
        self,
        compliance: NodalCompliance,
        modes: ModalPart | None = None,
        room: int = 0,
        near: bool = False,
    ) -> None:
        self.compliance = compliance
        self.modes = modes
        self.count = 0
        self._axes: Axes | None = None
        self._blocks: dict[tuple[int, int], Vector] = {}
        count = None if modes is None else modes.count
        self._store = _Store(compliance.readers, compliance.dimension, count, room, near)
        self.rows = Rows()

    def shares(self, other: ResponseTable, rows: int) -> bool:
        """Return whether the first so many rows are known to be those of another table."""
        return self._store is other._store and rows <= min(self.count, other.count)

    def between(self, rows: int | None = None) -> Vector:
        """Displacement of the first rows per force on them within a step, (n d, n d), m/N."""
        size = self.compliance.dimension * (self.count if rows is None else rows)
        return self._store.between[:size, :size]

    @property
    def store(self) -> Vector:
        """All of :meth:`between`, with room for rows to come, row by row in memory."""
        return self._store.between

    def yielding(self, part: float) -> ResponseTable:
        """Return the rows of now with a part of their compliance, to find a balance with."""
        twin = ResponseTable.__new__(ResponseTable)
        twin.compliance, twin.modes, twin.count = self.compliance, self.modes, self.count
        twin._axes, twin._blocks, twin.rows = None, {}, self.rows
        twin._store = copy.copy(self._store)
        twin._store.between = part * self.between()
        return twin

    def displacement(self, forces: Vector) -> Vector:
        """Return the displacement of all rows, (n, d), by forces (k, d) on the first k."""
        wide = self.compliance.dimension * self.count
        block = self._store.between[:wide, : forces.size]
        return product(block, forces.ravel()).reshape(self.count, -1)

    def along(self, axes: Axes, one: int, other: int) -> Vector:
        """Displacement of the rows along an axis per force along another, (n, n), m/N.

        Within a step, as :meth:`between`. What was asked for is kept while the axes are the
        same: most needles do not turn.
        """
        if self._axes is not axes:
            self._axes, self._blocks = axes, {}
        block = self._blocks.get((one, other))
        if block is None:
            block = self._blocks[one, other] = self._along(axes[one], axes[other])
        return block

    def _along(self, one: Axis, other: Axis) -> Vector:
        d, between, total = self.compliance.dimension, self.between(), None
        for a, x in one:
            for b, y in other:
                part = between[a::d, b::d] * (x * y)
                total = part if total is None else total + part
        assert total is not None
        return total

    def residual(self) -> Vector:
        """Displacement of the rows per static force on them, (n d, n d), m/N.

        Without that of the modes, if any.
        """
        size = self.compliance.dimension * self.count
        return self._store.residual[:size, :size]

    def beyond_mesh(self, forces: Vector) -> Vector:
        """Return of the displacement by static forces (n, d) what the mesh does not show."""
        if self._store.near is None:
            return np.zeros_like(forces)
        size = forces.size
        return product(self._store.near[:size, :size], forces.ravel()).reshape(forces.shape)

    def read_beyond_mesh(self, forces: Vector) -> Vector:
        """Return the same of the displacement at the readers, (r,)."""
        if self._store.near_read is None:
            return np.zeros(len(self._store.read))
        return product(self._store.near_read[:, : forces.size], forces.ravel())

    def at_readers(self) -> Vector:
        """Static displacement of the readers per force on the rows, (r, n d), m/N.

        Without that of the modes, if any.
        """
        return self._store.read[:, : self.compliance.dimension * self.count]

    def modal(self) -> Vector:
        """Shapes of the modes at the rows, (modes, n d)."""
        return self._store.modal[:, : self.compliance.dimension * self.count]

    def column(self, footprint: Footprint, component: int, rows: Rows) -> Vector:
        """Return the displacement of rows (n d,) per force component on a footprint, m/N.

        Of all rows and another one it is a part of :meth:`row`, which takes a tick's time as
        a whole.
        """
        return self.compliance.column(footprint, component, rows.nodes, rows.weights, rows.starts)

    def read(self, reading: Reading) -> Reading:
        """Return a reading with one component more, and with the modes when it is the last."""
        footprint, columns = reading.footprint, reading.columns
        column = np.empty(0)
        if self.count:
            column = self.column(footprint, len(columns), self.rows)
        columns = (*columns, column)
        if self.modes is None or len(columns) < self.compliance.dimension:
            return Reading(footprint, columns)
        return Reading(footprint, columns, self.modes.at(footprint))

    def reading(self, footprint: Footprint) -> Reading:
        """Return how a footprint moves under forces on the rows."""
        reading = Reading(footprint)
        for _ in range(self.compliance.dimension):
            reading = self.read(reading)
        return reading

    def row(
        self, footprint: Footprint, columns: tuple[Vector, ...] = (), rows: Rows | None = None
    ) -> ResponseRow:
        """Return what another row would be; its first columns, and all rows, may be known."""
        d = self.compliance.dimension
        rows = rows or self.rows.joined(footprint)
        rest = [self.column(footprint, a, rows) for a in range(len(columns), d)]
        static = np.stack([*columns, *rest], axis=1)
        static[-d:] = 0.5 * (static[-d:] + static[-d:].T)
        at_readers = self.compliance.at_readers(footprint)
        shape = np.zeros((0, d)) if self.modes is None else self.modes.at(footprint)
        return ResponseRow(rows, static, at_readers, shape)

    def appended(self, row: ResponseRow) -> ResponseTable:
        """Return a table with one more row; the common rows are shared, not copied."""
        count, d = self.count, self.compliance.dimension
        twin = ResponseTable.__new__(ResponseTable)
        twin.compliance, twin.modes, twin.count = self.compliance, self.modes, count + 1
        twin._axes, twin._blocks = None, {}
        twin._store = store = self._store.with_room(count)
        twin.rows = row.rows
        store.length = count + 1
        own, wide = slice(d * count, d * count + d), d * (count + 1)
        if row.near is not None:
            assert store.near is not None
            store.near[:wide, own] = row.near
            store.near[own, :wide] = row.near.T
        if row.near_read is not None:
            assert store.near_read is not None
            store.near_read[:, own] = row.near_read
        residual, at_readers = row.static, row.at_readers
        modes = self.modes
        if modes is not None:
            store.modal[:, own] = row.shape
            shapes = store.modal[:, :wide]
            moved = modes.static[:, None] * row.shape
            residual = residual - shapes.T @ moved
            at_readers = at_readers - modes.at_readers @ moved
            amended = shapes.T @ (modes.dynamic[:, None] * row.shape)
            amended += modes.residual_share * residual
            store.between[:wide, own] = amended
            store.between[own, :wide] = amended.T
        store.residual[:wide, own] = residual
        store.residual[own, :wide] = residual.T
        store.read[:, own] = at_readers
        return twin

    def sample(self, field: Vector) -> Vector:
        """Sample a nodal field, shape (nodes, d), at the rows; returns (n, d)."""
        if self.count == 0:
            return np.zeros((0, field.shape[1]))
        nodes, weights, starts = self.rows
        return samples(field.ravel(), nodes, weights, starts, field.shape[1]).reshape(
            self.count, -1
        )

    def loads(self, forces: Vector) -> Vector:
        """Spread forces on the first rows, (k, d), to `nodes`; returns (len(nodes), d), N."""
        if len(forces) < self.count:
            known = forces
            forces = np.zeros((self.count, known.shape[1]))
            forces[: len(known)] = known
        lengths = np.diff(np.append(self.rows.starts, len(self.rows.nodes)))
        return np.asarray(np.repeat(forces, lengths, axis=0) * self.rows.weights[:, None])

    def spread(self, forces: Vector) -> Vector:
        """Spread forces on the rows, shape (n, d), to all nodes; returns (nodes, d), N."""
        each, total = self.loads(forces), self.compliance.total_nodes
        columns = [np.bincount(self.rows.nodes, weights=f, minlength=total) for f in each.T]
        return np.stack(columns, axis=1)


def _widened(array: Vector, size: int, columns: int, rows: int | None = None) -> Vector:
    """Return the first columns of an array, (rows of it, size), or of a square one a part."""
    wider = np.zeros((len(array) if rows is None else size, size))
    wider[:rows, :columns] = array[:rows, :columns]
    return wider


class ModalPart:
    """How a set of modes amends the static compliance of a step.

    A mode that moves with Newmark answers a unit modal force with ``dynamic`` within the
    step; the static compliance already contains ``static`` of it, of which the share
    ``residual_share`` is left.

    Parameters
    ----------
    shapes : ndarray, shape (nodes, d, modes)
    at_readers : ndarray, shape (r, modes)
        Shapes at the readers.
    dynamic, static : ndarray, shape (modes,)
    residual_share : float
    """

    def __init__(
        self,
        shapes: Vector,
        at_readers: Vector,
        dynamic: Vector,
        static: Vector,
        residual_share: float,
    ) -> None:
        self.shapes, self.at_readers = shapes, at_readers
        self.count = shapes.shape[2]
        self.dynamic, self.static = dynamic, static
        self.residual_share = residual_share

    def at(self, footprint: Footprint) -> Vector:
        """Return the shapes at a footprint, (modes, d)."""
        flat = self.shapes.reshape(len(self.shapes), -1)
        summed = weighted_rows(flat, footprint.nodes, footprint.weights, 0, flat.shape[1])
        return summed.reshape(-1, self.count).T
