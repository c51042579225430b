# SPDX-License-Identifier: Apache-2.0
"""A plan beside the plain aim, in the undeformed and in the deformed tissue."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_sim_ros.planning.keep_out import distance
from needle_sim_ros.view.style import BLACK, BLUE, MM, ORANGE, styled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.planning.planner import Plan
    from needle_sim_ros.scene import Region, Scene

_NAMES = "xyz"
_SAMPLES = 200
_LEAST_ROOM = 8e-3  # m, shown to either side of the target


def plan_figure(
    scene: Scene, plan: Plan, target: Sequence[float], keep_out: Sequence[Region] = ()
) -> Figure:
    """Draw plain aim and plan side by side, one row for each lateral direction.

    The lines are the needle's way through the undeformed tissue.
    """
    axes_shown = [0] if scene.dimension == 2 else [0, 1]
    with styled():
        figure = Figure(figsize=(7.2, 3.6 * len(axes_shown)), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(len(axes_shown), 2, squeeze=False, sharex="row", sharey="row")
        for row, axis in enumerate(axes_shown):
            for column, (name, outcome, colour) in enumerate(
                (("plain aim", plan.plain, ORANGE), ("planned", plan.outcome, BLUE))
            ):
                ax = panels[row, column]
                _draw_tissue(ax, scene, axis, target, keep_out)
                ax.plot(
                    MM * outcome.track[:, axis],
                    MM * outcome.track[:, 2],
                    color=colour,
                    linewidth=2,
                    label="track in the undeformed tissue",
                )
                for where, mark, label in (
                    (outcome.target, "o", "target where it has moved to"),
                    (outcome.tip, "x", "tip"),
                ):
                    ax.plot(
                        MM * where[axis],
                        MM * where[2],
                        mark,
                        color=BLACK,
                        markerfacecolor="none",
                        label=label,
                    )
                if row == 0:
                    ax.set_title(f"{name}: miss {MM * outcome.miss:.2f} mm")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=2)
        figure.suptitle(scene.name)
    return figure


def _draw_tissue(
    ax: Axes, scene: Scene, axis: int, target: Sequence[float], keep_out: Sequence[Region]
) -> None:
    half, depth = MM * scene.tissue.size[axis] / 2, MM * scene.tissue.size[-1]
    ax.plot([-half, -half, half, half], [0, -depth, -depth, 0], color=BLACK, linewidth=0.8)
    ax.axhline(0.0, color=BLACK, linewidth=0.8)
    ax.plot(MM * target[axis], MM * target[2], "+", color=BLACK, label="target in the scene")
    x = np.linspace(-half, half, _SAMPLES) / MM
    z = np.linspace(-depth, 0.0, _SAMPLES) / MM
    for region in keep_out:
        points = np.zeros((_SAMPLES, _SAMPLES, 3))
        points[..., 1 - axis] = region.center[1 - axis]
        points[..., axis], points[..., 2] = x[None, :], z[:, None]
        level: NDArray[np.float64] = distance(points.reshape(-1, 3), region)
        ax.contourf(
            MM * x,
            MM * z,
            level.reshape(_SAMPLES, _SAMPLES),
            levels=[-np.inf, 0.0],
            colors=["0.8"],
        )
    room = MM * max(_LEAST_ROOM, 0.5 * abs(target[2]))
    ax.set_xlim(MM * target[axis] - room, MM * target[axis] + room)
    ax.set_ylim(MM * target[2] - 0.2 * room, 0.2 * room)
    ax.set_aspect("equal")
    ax.set_xlabel(f"{_NAMES[axis]} (mm)")
    ax.set_ylabel("z (mm)")
