# SPDX-License-Identifier: Apache-2.0
"""What was applied since the simulation started, for recordings that begin later.

Motions, and changes of the interaction laws with the number of ticks before them.
"""

from __future__ import annotations

import json
import mmap
import struct
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.session.motion import Motion

_LIMIT = 50_000
_ROW = 9  # is a pose, number of ticks, up to seven numbers
_PACK = {"pose": struct.Struct("=9d").pack_into, "velocity": struct.Struct("=8d").pack_into}
_NO_ROWS = np.empty((0, _ROW))


class History:
    """The motions of all ticks since the start or the last reset, runs of equal ones as one.

    Parameters
    ----------
    limit : int
        Runs that are kept, at 72 bytes each; a history that has more is given up, and
        says so.
    """

    def __init__(self, limit: int = _LIMIT) -> None:
        self._limit = limit
        self._rows = _NO_ROWS
        self.clear()

    def reserve(self) -> None:
        """Take all the memory at once, so that no tick has to wait for some."""
        if not len(self._rows):
            self._rows = _room(self._limit)

    def clear(self) -> None:
        """Forget everything: the simulation is at its start again."""
        self._used = 0
        self._last: Motion | None = None
        self._count = 0
        self.ticks = 0
        self.complete = True
        self.changes: list[tuple[int, dict[str, float]]] = []

    def add(self, motion: Motion) -> None:
        """Note the motion of one tick."""
        self.ticks += 1
        if motion is self._last or motion == self._last:
            self._count += 1
            return
        if self._last is not None and self.complete:
            self.reserve()
            last = self._last
            _PACK[last.kind](
                self._rows.data,
                8 * _ROW * self._used,
                last.kind == "pose",
                self._count,
                *last.values(),
            )
            self._used += 1
            if self._used == self._limit:
                self.complete = False
                self._rows, self._used = _NO_ROWS, 0
        self._last, self._count = motion, 1

    def copy(self) -> History:
        """Return the history up to now, which does not go on."""
        twin = History(self._limit)
        twin._rows, twin._used = self._rows[: self._used].copy(), self._used
        twin._last, twin._count = self._last, self._count
        twin.ticks, twin.complete, twin.changes = self.ticks, self.complete, self.changes[:]
        return twin

    def change(self, values: Mapping[str, float]) -> None:
        """Note that laws changed, by keys below `interaction`, before the next tick."""
        self.changes.append((self.ticks, dict(values)))
        if len(self.changes) > self._limit:
            self.complete = False
            self.changes = self.changes[-1:]

    def changes_json(self) -> str:
        """Return ``[[ticks before, {key: value}], ...]``."""
        return json.dumps(self.changes)

    def runs(self) -> Iterator[tuple[Motion, int]]:
        """Yield motions and for how many ticks each was applied."""
        for row in self._rows[: self._used]:
            is_pose, count, *values = row.tolist()
            if is_pose:
                yield Motion.from_values("pose", values), int(count)
            else:
                yield Motion.from_values("velocity", values[:6]), int(count)
        if self._last is not None:
            yield self._last, self._count

    def to_json(self) -> str:
        """Return ``[[kind, ticks, [numbers]], ...]``, or ``null`` when it was given up.

        Numbers are written so that they are read back to the last bit.
        """
        if not self.complete:
            return "null"
        # row by row: the encoder would keep the interpreter lock for tenths of a second
        rows = (json.dumps([motion.kind, n, motion.values()]) for motion, n in self.runs())
        return f"[{', '.join(rows)}]"


def _room(rows: int) -> NDArray[np.float64]:
    """Return zeros in memory of their own, there at once; it goes back when it is given up."""
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | getattr(mmap, "MAP_POPULATE", 0)
    return np.frombuffer(mmap.mmap(-1, 8 * _ROW * rows, flags)).reshape(rows, _ROW)


def motions_from_json(text: str) -> list[tuple[Motion, int]] | None:
    """Return the runs of a history written by :meth:`History.to_json`."""
    data = json.loads(text)
    if data is None:
        return None
    return [(Motion.from_values(kind, values), int(count)) for kind, count, values in data]


def changes_from_json(text: str) -> list[tuple[int, dict[str, float]]]:
    """Return the changes written by :meth:`History.changes_json`."""
    return [
        (int(ticks), {str(key): float(value) for key, value in values.items()})
        for ticks, values in json.loads(text)
    ]
