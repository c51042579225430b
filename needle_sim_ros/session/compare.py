# SPDX-License-Identifier: Apache-2.0
"""How far two runs are apart, channel by channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.session.series import Array, Series

UNITS = {
    "base_force": "N",
    "base_torque": "N m",
    "tip_position": "m",
    "tip_orientation": "1",
    "tip_deflection": "m",
    "marker_positions": "m",
    "marker_displacements": "m",
    "insertion_depth": "m",
    "process": "1",
    "base_position": "m",
    "base_orientation": "1",
    "friction_force": "N",
    "tip_force": "N",
}


@dataclass(frozen=True)
class Difference:
    """Largest and root-mean-square difference of a channel, over ticks and components."""

    max_abs: float
    rms: float
    unit: str


def compare(recorded: Series, simulated: Series) -> tuple[dict[str, Difference], int]:
    """Compare the ticks that both have.

    Parameters
    ----------
    recorded, simulated : Series
        With the same clock.

    Returns
    -------
    dict of str to Difference
        By channel; channels that only one has, or in another shape, are left out.
        `process` counts 1 where the processes differ. A number that only one of them has
        (NaN in the other) is an infinite difference.
    int
        How many ticks were compared.
    """
    before, after = _clock(recorded), _clock(simulated)
    _, left, right = np.intersect1d(before, after, return_indices=True)
    found = {}
    for name, unit in UNITS.items():
        a, b = _channel(recorded, name), _channel(simulated, name)
        if a is None or b is None or a.shape[1:] != b.shape[1:]:
            continue
        apart = (
            (a[left] != b[right]).astype(float) if name == "process" else _apart(a[left], b[right])
        )
        size = apart.size
        found[name] = Difference(
            max_abs=float(apart.max()) if size else 0.0,
            rms=float(np.sqrt(np.mean(apart**2))) if size else 0.0,
            unit=unit,
        )
    return found, len(left)


def beyond(differences: Mapping[str, Difference], tolerances: Mapping[str, float]) -> list[str]:
    """Return the channels whose largest difference is beyond their tolerance.

    Parameters
    ----------
    differences : mapping
        See :func:`compare`.
    tolerances : mapping of str to float
        By channel, in its unit; the empty name stands for all others; else zero.
    """
    general = tolerances.get("", 0.0)
    return [n for n, d in differences.items() if d.max_abs > tolerances.get(n, general)]


def read_tolerances(texts: list[str]) -> dict[str, float]:
    """Read ``NUMBER`` and ``CHANNEL=NUMBER``.

    Raises
    ------
    NeedleSimError
        On what is neither.
    """
    tolerances = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        if name and name not in UNITS:
            raise NeedleSimError(f"--tolerance {text}: the channels are {', '.join(UNITS)}")
        try:
            tolerances[name] = float(number)
        except ValueError:
            raise NeedleSimError(
                f"--tolerance {text}: must be a number or CHANNEL=NUMBER"
            ) from None
        if not tolerances[name] >= 0.0:
            raise NeedleSimError(f"--tolerance {text}: must not be negative")
    return tolerances


def _clock(series: Series) -> NDArray[np.int64]:
    return np.round(series.time * 1e9).astype(np.int64)


def _channel(series: Series, name: str) -> Array | None:
    value = getattr(series, name)
    return None if value is None else np.asarray(value)


def _apart(a: Array, b: Array) -> Array:
    with np.errstate(invalid="ignore"):
        apart = np.abs(a - b)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    result: Array = np.where(same, 0.0, np.where(np.isnan(apart), np.inf, apart))
    return result
