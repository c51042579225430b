# SPDX-License-Identifier: Apache-2.0
"""Error against run time: every measured setting, the best ones joined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from needle_sim_ros.view.style import BLACK, BLUE, ORANGE, VERMILION, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = dict[str, Any]

# method: colour, marker, name
_METHODS = {
    "quasi_static": (BLUE, "o", "quasi-static"),
    "reduced": (ORANGE, "s", "Newmark, reduced"),
    "newmark": (VERMILION, "^", "Newmark, every unknown"),
}
_PAPER = "paper"
_PAPER_NAMES = {"o": "quasi-static", "^": "Newmark"}


def front(rows: Sequence[Row]) -> list[Row]:
    """Return the rows than which no other is both faster and more accurate, fastest first."""
    best: list[Row] = []
    for row in sorted(rows, key=lambda r: (r["tick_ms"], r["max_error"])):
        if not best or row["max_error"] < best[-1]["max_error"]:
            best.append(row)
    return best


def pareto_figure(rows: Sequence[Row], title: str) -> Figure:
    """Draw error against tick time, logarithmically.

    Parameters
    ----------
    rows : sequence of dict
        With ``method``, ``run`` (``default`` and ``paper`` are marked), ``max_error`` as a
        fraction and ``tick_ms``.
    title : str
    """
    with styled():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.2, 4.6), layout="constrained")
        ax = figure.subplots()
        for panel_method, (colour, marker, name) in _METHODS.items():
            mine = [row for row in rows if row["method"] == panel_method]
            _draw_method(ax, mine, colour, marker, name)
        ax.axhline(1.0, color="#7f7f7f", linewidth=0.8, linestyle=(0, (1, 2)), zorder=0)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.grid(True, which="major", color="#e5e5e5", linewidth=0.6)
        ax.set_axisbelow(True)
        _plain_ticks(ax)
        ax.set_xlabel("median tick, needle inserted (ms; load of the machine evened out)")
        ax.set_ylabel("largest error of any quantity over the protocol (%)")
        ax.set_title(title)
        ax.legend(loc="center right", bbox_to_anchor=(1.0, 0.62), borderaxespad=0.0)
    return figure


def _draw_method(ax: Axes, rows: Sequence[Row], colour: str, marker: str, name: str) -> None:
    own = [row for row in rows if row["run"] != _PAPER]
    if own:
        ax.scatter(
            [r["tick_ms"] for r in own],
            [100 * r["max_error"] for r in own],
            s=22,
            marker=marker,
            facecolor="none",
            edgecolor=colour,
            linewidth=1.0,
        )
        best = front(own)
        ax.plot(
            [r["tick_ms"] for r in best],
            [100 * r["max_error"] for r in best],
            color=colour,
            marker=marker,
            markersize=4.5,
            linewidth=1.4,
            label=f"{name}: Pareto front",
        )
    for row in rows:
        place = row["tick_ms"], 100 * row["max_error"]
        if row["run"] == "default":
            ax.plot(
                *place,
                marker="*",
                markersize=15,
                color=colour,
                markeredgecolor=BLACK,
                linestyle="none",
                label=f"{name}: default",
                zorder=5,
            )
        if row["run"] == _PAPER:
            ax.plot(
                *place,
                marker="X",
                markersize=10,
                color="#ffffff",
                markeredgecolor=colour,
                markeredgewidth=1.5,
                linestyle="none",
                label=f"the paper's method, {_PAPER_NAMES[marker]}",
                zorder=5,
            )


def _plain_ticks(ax: Axes) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator

    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
