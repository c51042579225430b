# SPDX-License-Identifier: Apache-2.0
"""How far a simulation is from what was measured, at the times of the measurements."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.session.compare import Difference
from needle_sim_ros.session.experiment import UNITS, Experiment, interpolated
from needle_sim_ros.session.series import Series

# What a difference is called in tables and JSON, as in a replay of a session.
NAMES = {
    "force": "base_force",
    "torque": "base_torque",
    "markers": "marker_displacements",
    "tip": "tip_position",
}


def simulated_rows(series: Series, quantity: str) -> Vector:
    """Return the rows (n, ...) of a series that stand for a measured quantity."""
    return np.asarray(getattr(series, NAMES[quantity]))


def agreement(experiment: Experiment, series: Series) -> dict[str, Difference]:
    """Return greatest and root-mean-square differences by quantity, under its series' name.

    Parameters
    ----------
    experiment : Experiment
    series : Series
        One row for each tick of it.
    """
    residuals = residuals_of(experiment, series)
    found = {}
    for quantity, apart in residuals.items():
        seen = apart[np.isfinite(apart)]
        found[NAMES[quantity]] = Difference(
            max_abs=float(np.abs(seen).max(initial=0.0)),
            rms=float(np.sqrt(np.mean(seen**2))) if len(seen) else 0.0,
            unit=UNITS[quantity],
        )
    return found


def residuals_of(experiment: Experiment, series: Series) -> Mapping[str, Vector]:
    """Return simulated minus measured rows, by quantity."""
    return {
        quantity: interpolated(measured.time, series.time, simulated_rows(series, quantity))
        - measured.values
        for quantity, measured in experiment.measured.items()
    }
