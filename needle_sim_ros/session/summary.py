# SPDX-License-Identifier: Apache-2.0
"""What a run comes to: a few figures out of its series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from needle_sim_ros.session.series import Array, Series


@dataclass(frozen=True)
class Summary:
    """Figures of a run; ``None`` where it does not show them.

    Parameters
    ----------
    ticks : int
        How many.
    duration : float
        Simulated time, s.
    peak_base_force : dict of str to float
        Largest magnitude of the base force in each process that occurred, N.
    puncture_force, puncture_depth : float or None
        Largest magnitude of the base force, N, up to the tick in which the surface first
        broke, and how far the tip was below the undeformed surface then, m.
    max_insertion_depth, max_tip_deflection, max_marker_displacement : float or None
        Largest magnitudes, m.
    tick_median, tick_p99 : float or None
        Wall-clock time of a tick, s.
    real_time_factor : float or None
        Simulated over wall-clock time.
    """

    ticks: int
    duration: float
    peak_base_force: dict[str, float]
    puncture_force: float | None
    puncture_depth: float | None
    max_insertion_depth: float
    max_tip_deflection: float
    max_marker_displacement: float | None
    tick_median: float | None = None
    tick_p99: float | None = None
    real_time_factor: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures under names that end in their units."""
        return {
            "ticks": self.ticks,
            "duration_s": self.duration,
            "peak_base_force_n": dict(self.peak_base_force),
            "puncture_force_n": self.puncture_force,
            "puncture_depth_m": self.puncture_depth,
            "max_insertion_depth_m": self.max_insertion_depth,
            "max_tip_deflection_m": self.max_tip_deflection,
            "max_marker_displacement_m": self.max_marker_displacement,
            "tick_median_s": self.tick_median,
            "tick_p99_s": self.tick_p99,
            "real_time_factor": self.real_time_factor,
        }


def summarise(
    series: Series,
    time_step: float,
    tick_times: Array | None = None,
    wall_time: float | None = None,
) -> Summary:
    """Reduce a series of at least one tick of ``time_step`` seconds to its summary."""
    force = np.linalg.norm(series.base_force, axis=1)
    process = np.array(series.process)
    peaks = {name: float(force[process == name].max()) for name in dict.fromkeys(series.process)}
    duration = len(series) * time_step
    puncture = _puncture_tick(series.process, force)
    moved = np.linalg.norm(series.marker_displacements, axis=2)
    return Summary(
        ticks=len(series),
        duration=duration,
        peak_base_force=peaks,
        puncture_force=None if puncture is None else float(force[puncture]),
        puncture_depth=None if puncture is None else float(-series.tip_position[puncture, 2]),
        max_insertion_depth=float(series.insertion_depth.max()),
        max_tip_deflection=float(np.linalg.norm(series.tip_deflection, axis=1).max()),
        max_marker_displacement=float(moved.max()) if moved.size else None,
        tick_median=None if tick_times is None else float(np.median(tick_times)),
        tick_p99=None if tick_times is None else float(np.percentile(tick_times, 99)),
        real_time_factor=duration / wall_time if wall_time else None,
    )


def _puncture_tick(process: list[str], force: Array) -> int | None:
    """Return the tick of the largest force up to the first of the first insertion."""
    if "insertion" not in process:
        return None
    return int(np.argmax(force[: process.index("insertion") + 1]))
