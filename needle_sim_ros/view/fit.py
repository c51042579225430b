# SPDX-License-Identifier: Apache-2.0
"""What was measured and what the model says, before and after a fit, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.session.agreement import NAMES
from needle_sim_ros.session.experiment import interpolated
from needle_sim_ros.view.style import BLACK, BLUE, MM, ORANGE, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needle_sim_ros.geometry import Vector
    from needle_sim_ros.session.experiment import Experiment
    from needle_sim_ros.session.series import Series

_LABELS = {
    "force": "axial base force (N)",
    "markers": "greatest marker\ndisplacement (mm)",
    "tip": "tip x (mm)",
    "torque": "base torque (N m)",
}


@dataclass(frozen=True, eq=False)
class Curves:
    """Curves of one experiment.

    Attributes
    ----------
    name : str
    time : mapping
        s, (n,), by quantity.
    measured : mapping
        Rows by quantity.
    models : mapping
        Rows by quantity, by name of the model: ``simulated``, or ``before`` and ``after``.
    """

    name: str
    time: Mapping[str, Vector]
    measured: Mapping[str, Vector]
    models: Mapping[str, Mapping[str, Vector]] = field(default_factory=dict)

    @classmethod
    def of(cls, experiment: Experiment, **models: Series) -> Curves:
        """Take an experiment and series of its ticks."""
        known = experiment.measured
        return cls(
            experiment.name,
            {name: m.time for name, m in known.items()},
            {name: m.values for name, m in known.items()},
            {
                model: {
                    name: interpolated(m.time, series.time, getattr(series, NAMES[name]))
                    for name, m in known.items()
                }
                for model, series in models.items()
            },
        )


def fit_figure(experiments: Sequence[Curves], title: str, notes: str = "") -> Figure:
    """Draw one column for each experiment, one row for each quantity measured.

    Raises
    ------
    NeedleSimError
        When nothing was measured.
    """
    names = [name for name in _LABELS if any(name in e.measured for e in experiments)]
    if not names:
        raise NeedleSimError("nothing to plot: nothing was measured")
    with styled():
        wide = max(7.0, 5.5 * len(experiments))
        figure = Figure(figsize=(wide, 2.6 * len(names)), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(names), len(experiments), sharex="col", squeeze=False)
        for column, curves in enumerate(experiments):
            grid[0, column].set_title(curves.name)
            grid[-1, column].set_xlabel("time (s)")
            for row, name in enumerate(names):
                _draw(grid[row, column], curves, name)
                grid[row, 0].set_ylabel(_LABELS[name])
        grid[0, -1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        if notes:
            figure.supxlabel(notes, x=0.01, ha="left", fontsize=8.5, color="0.25")
    return figure


def _draw(ax: Axes, curves: Curves, name: str) -> None:
    ax.axhline(0.0, color="0.4", linewidth=0.7)
    if name not in curves.measured:
        return
    time, measured = curves.time[name], _curve(name, curves.measured[name])
    ax.plot(time, measured, ".", color=ORANGE, markersize=2.0, label="measured")
    colours = {"before": BLUE}
    last = None
    for model, rows in curves.models.items():
        last = _curve(name, rows[name])
        dashes = "--" if model == "before" else "-"
        ax.plot(time, last, dashes, color=colours.get(model, BLACK), linewidth=1.2, label=model)
    if last is not None:
        ax.plot(time, last - measured, color="0.35", linewidth=0.7, label="left over")


def _curve(name: str, rows: Vector) -> Vector:
    if name == "force":
        return np.asarray(rows[:, 2])
    if name == "tip":
        return np.asarray(MM * rows[:, 0])
    if name == "torque":
        return np.asarray(rows[:, 1])
    lengths = MM * np.linalg.norm(rows, axis=-1)
    return np.asarray(np.nanmax(np.where(np.isnan(lengths), -1.0, lengths), axis=1))
