# SPDX-License-Identifier: Apache-2.0
"""Results as rows of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needle_sim_ros.session.summary import Summary


def summary_rows(summary: Summary) -> list[tuple[str, str]]:
    """Return a summary as rows of name and value; what is not known is left out."""
    rows: list[tuple[str, float | None, float, str]] = [
        (f"peak base force, {process}", force, 1.0, "N")
        for process, force in summary.peak_base_force.items()
        if process != "free"
    ]
    rows += [
        ("puncture force", summary.puncture_force, 1.0, "N"),
        ("puncture at an indentation of", summary.puncture_depth, 1e3, "mm"),
        ("greatest insertion depth", summary.max_insertion_depth, 1e3, "mm"),
        ("greatest tip deflection", summary.max_tip_deflection, 1e3, "mm"),
        ("greatest marker displacement", summary.max_marker_displacement, 1e3, "mm"),
        ("simulated time", summary.duration, 1.0, "s"),
        ("tick, median", summary.tick_median, 1e3, "ms"),
        ("tick, 99th percentile", summary.tick_p99, 1e3, "ms"),
        ("real-time factor", summary.real_time_factor, 1.0, ""),
    ]
    text = [("ticks", f"{summary.ticks}   ")]
    for name, value, factor, unit in rows:
        if value is not None:
            text.append((name, f"{_significant(factor * value)} {unit:<2}"))
    return text


def _significant(value: float) -> str:
    """Return the value to three significant digits, without exponents where they do not help."""
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        digits = max(0, 2 - int(f"{value:.2e}".split("e")[1]))
        return f"{value:.{digits}f}"
    return f"{value:.2e}"
