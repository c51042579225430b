# SPDX-License-Identifier: Apache-2.0
"""Which measured settings to use for a time, or for an error."""

from __future__ import annotations

from collections.abc import Sequence

from needle_sim_ros.benchmark.result import Row


def recommend(
    rows: Sequence[Row], budget: float | None = None, error: float | None = None
) -> Row | None:
    """Return the best row of the accuracy benchmark within limits.

    Parameters
    ----------
    rows : sequence of dict
        The benchmark's table.
    budget : float, optional
        Longest tick, ms. Alone: the most accurate run within it.
    error : float, optional
        Largest error, a fraction: the fastest run within it, and within the budget.

    Returns
    -------
    dict or None
        None when no run is within the limits. The paper's method is never proposed.
    """
    within = [
        row
        for row in rows
        if row["compared"]
        and row["run"] != "paper"
        and (budget is None or row["tick_ms"] <= budget)
        and (error is None or row["max_error"] <= error)
    ]
    by = ("max_error", "tick_ms") if error is None else ("tick_ms", "max_error")
    return min(within, key=lambda row: tuple(row[name] for name in by), default=None)
