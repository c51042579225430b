# SPDX-License-Identifier: Apache-2.0
"""What was applied since the simulation started, for recordings that begin later."""

from __future__ import annotations

import json

from needle_sim_ros.session.motion import Motion

_LIMIT = 50_000


class History:
    """The motions of all ticks since the start or the last reset, runs of equal ones as one.

    Parameters
    ----------
    limit : int
        Runs that are kept; a history that has more is given up, and says so.
    """

    def __init__(self, limit: int = _LIMIT) -> None:
        self._limit = limit
        self.clear()

    def clear(self) -> None:
        """Forget everything: the simulation is at its start again."""
        self._runs: list[tuple[Motion, int]] = []
        self._last: Motion | None = None
        self._count = 0
        self.ticks = 0
        self.complete = True

    def add(self, motion: Motion) -> None:
        """Note the motion of one tick."""
        self.ticks += 1
        if motion is self._last or motion == self._last:
            self._count += 1
            return
        self._close()
        self._last, self._count = motion, 1

    def to_json(self) -> str:
        """Return ``[[kind, ticks, [numbers]], ...]``, or ``null`` when it was given up.

        Numbers are written so that they are read back to the last bit.
        """
        if not self.complete:
            return "null"
        last = [(self._last, self._count)] if self._last is not None else []
        runs = [*self._runs, *last]
        return json.dumps([[motion.kind, count, motion.values()] for motion, count in runs])

    def _close(self) -> None:
        if self._last is not None and self.complete:
            self._runs.append((self._last, self._count))
            if len(self._runs) >= self._limit:
                self.complete = False
                self._runs = []


def motions_from_json(text: str) -> list[tuple[Motion, int]] | None:
    """Return the runs of a history written by :meth:`History.to_json`."""
    data = json.loads(text)
    if data is None:
        return None
    return [(Motion.from_values(kind, values), int(count)) for kind, count, values in data]
