# SPDX-License-Identifier: Apache-2.0
"""Observations of a known number of ticks as the series that a recording of them gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from needle_sim_ros.session.encoding import tip_orientation
from needle_sim_ros.session.series import Array, Series

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation

_VECTORS = ("base_force", "base_torque", "tip_position", "tip_deflection", "base_position")
_SCALARS = ("insertion_depth", "friction_force", "tip_force")


class Collector:
    """Rows of arrays, filled tick by tick; no message is made and read back.

    Parameters
    ----------
    count : int
        Ticks, at most.
    markers : int
        Markers of the scene.
    """

    def __init__(self, count: int, markers: int) -> None:
        self._times: list[int] = []
        self._process: list[str] = []
        self._rows: dict[str, Array] = {name: np.zeros((count, 3)) for name in _VECTORS}
        self._rows |= {name: np.zeros((count, 4)) for name in ("tip_orientation", "orientation")}
        self._rows |= {name: np.zeros(count) for name in _SCALARS}
        # as wide as they are published and recorded
        self._positions = np.zeros((count, markers, 3), dtype=np.float32)
        self._moved = np.zeros((count, markers, 3), dtype=np.float32)

    def add(self, log_time: int, seen: Observation) -> None:
        """Take an observation under its log time, ns."""
        k, rows = len(self._times), self._rows
        self._times.append(log_time)
        self._process.append(seen.process.value)
        for name in _VECTORS:
            rows[name][k] = getattr(seen, name)
        for name in _SCALARS:
            rows[name][k] = getattr(seen, name)
        rows["orientation"][k] = seen.base_orientation
        rows["tip_orientation"][k] = tip_orientation(seen)
        self._positions[k] = seen.marker_positions
        self._moved[k] = seen.marker_displacements

    def series(self, scene_text: str, about: Mapping[str, str]) -> Series:
        """Return the series, by log time; of equal times the last counts."""
        last = {time: k for k, time in enumerate(self._times)}
        times = sorted(last)
        chosen = [last[time] for time in times]
        order: slice | Sequence[int] = chosen
        if chosen == list(range(len(self._times))):
            order = slice(len(chosen))
        rows = {name: array[order] for name, array in self._rows.items()}
        moved = self._moved[order].astype(float)
        first = self._positions[chosen[:1]].astype(float)
        empty = np.zeros((0, 3))
        return Series(
            time=np.array(times, dtype=float) * 1e-9,
            process=[self._process[k] for k in chosen],
            marker_reference=first[0] - moved[0] if len(first) else empty,
            marker_displacements=moved if len(first) else np.zeros((0, 0, 3)),
            base_orientation=rows.pop("orientation"),
            scene_text=scene_text,
            metadata=about,
            **rows,
        )
