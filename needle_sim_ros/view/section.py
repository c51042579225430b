# SPDX-License-Identifier: Apache-2.0
"""The tissue cut in the plane y = 0: displacement, needle, track, markers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import patheffects
from matplotlib.patches import Polygon

from needle_sim_ros.tissue.material import in_region
from needle_sim_ros.view.style import BLACK, COLOUR_MAP, MM, ORANGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needle_sim_ros.observation import Observation
    from needle_sim_ros.simulator import Simulator

    Array = NDArray[np.float64]

GRID_LINES = 10e-3  # m between the material lines
_FINEST = 0.75e-3  # m between samples of the displacement
_MOST = 240  # samples along an edge
_ABOVE = 0.22  # of the depth: how much is shown above the surface


@dataclass(frozen=True, eq=False)
class Section:
    """The state of a simulation in the plane y = 0 at one instant.

    Parameters
    ----------
    time, insertion_depth : float
        s, m.
    grid : (p, q, 3) array
        Sampled material points of the undeformed tissue, row by row downwards, m.
    displacement : (p, q, 3) array
        m.
    needle : (k, 3) array
        Centre line from the base to the tip, m.
    track : (t, 3) array
        Inserted track points where they are, m.
    markers : (n, 3) array
        Where they are, m.
    radius, bevel : float
        Needle's radius and the length of its bevel, m.
    bevel_side : float
        +1 when the sharp edge is on the +x side, else -1.
    regions : (r, p, q) bool array
        Which material points lie in each of the scene's regions.
    name : str
        What it is called.
    """

    time: float
    insertion_depth: float
    grid: Array
    displacement: Array
    needle: Array
    track: Array
    markers: Array
    radius: float
    bevel: float
    bevel_side: float
    regions: NDArray[np.bool_]
    name: str = "Section"


def take_section(sim: Simulator, observation: Observation) -> Section:
    """Sample the simulator's present state, which ``observation`` describes."""
    scene = sim.scene
    width, depth = scene.tissue.size[0], scene.tissue.size[-1]
    x = np.linspace(-width / 2, width / 2, _samples(width))
    z = np.linspace(0.0, -depth, _samples(depth))
    grid = np.zeros((len(z), len(x), 3))
    grid[..., 0], grid[..., 2] = x[None, :], z[:, None]
    moved = sim.tissue_displacement(grid.reshape(-1, 3)).reshape(grid.shape)
    points = np.asarray(observation.contact_points, dtype=float).reshape(-1, 3)
    track = points + sim.tissue_displacement(points) if len(points) else points
    tip = scene.needle.tip
    return Section(
        time=float(observation.time),
        insertion_depth=float(observation.insertion_depth),
        grid=grid,
        displacement=moved,
        needle=np.array(observation.needle_points),
        track=track,
        markers=np.array(observation.marker_positions).reshape(-1, 3),
        radius=scene.needle.radius,
        bevel=2 * scene.needle.radius / math.tan(tip.bevel_angle),
        bevel_side=-1.0 if tip.deviation_angle * math.cos(tip.roll) < 0 else 1.0,
        regions=np.array(
            [in_region(scene, region, np.moveaxis(grid, 2, 0)) for region in scene.tissue.regions],
            dtype=bool,
        ).reshape(-1, *grid.shape[:2]),
        name="Section" if scene.dimension == 2 else "Cut y = 0",
    )


def _samples(length: float) -> int:
    return int(min(_MOST, max(8, round(length / _FINEST)))) + 1


def draw_section(ax: Axes, section: Section, largest: float | None = None) -> None:
    """Draw the deformed section at true scale, coloured by displacement magnitude.

    Parameters
    ----------
    ax : Axes
        To draw into.
    section : Section
        What to draw.
    largest : float, optional
        Displacement at the end of the colour scale, m; by default the section's largest.
    """
    # beside an organ there is no tissue: nothing is drawn there
    size = np.ma.masked_invalid(MM * np.linalg.norm(section.displacement, axis=2))
    placed = MM * (section.grid + np.nan_to_num(section.displacement))
    outside = np.isnan(section.displacement)
    mesh = ax.pcolormesh(
        placed[..., 0],
        placed[..., 2],
        size,
        shading="gouraud",
        cmap=COLOUR_MAP,
        vmin=0.0,
        vmax=None if largest is None else MM * largest,
        rasterized=True,
    )
    _draw_grid_lines(ax, section.grid, np.where(outside, np.nan, placed))
    _draw_regions(ax, section.regions, placed)
    if len(section.markers):
        x, z = MM * section.markers[:, [0, 2]].T
        dot: dict[str, Any] = {"markersize": 3.5, "markerfacecolor": "white"}
        ax.plot(x, z, "o", color=BLACK, label="markers", **dot)
    body: dict[str, Any] = {"facecolor": "0.85", "edgecolor": BLACK, "linewidth": 0.8, "zorder": 4}
    ax.add_patch(Polygon(MM * needle_outline(section), label="needle", **body))
    halo = [patheffects.Stroke(linewidth=2.6, foreground="white"), patheffects.Normal()]
    if len(section.track):
        ax.plot(
            *MM * section.track[:, [0, 2]].T,
            color=ORANGE,
            linestyle=(0, (3, 1.5)),
            linewidth=1.4,
            path_effects=halo,
            label="track",
            zorder=5,
        )
    left, right = MM * section.grid[0, 0, 0], MM * section.grid[0, -1, 0]
    bottom = MM * section.grid[-1, 0, 2]
    ax.set_xlim(1.03 * left, 1.03 * right)
    ax.set_ylim(1.03 * bottom, -_ABOVE * bottom)
    ax.set_aspect("equal")
    ax.set_xlabel("x (mm)")
    ax.set_ylabel("z (mm)")
    ax.set_title(
        f"{section.name} at {section.time:.1f} s, {MM * section.insertion_depth:.1f} mm deep"
    )
    ax.set_anchor("W")
    # Inset, so that it stays beside the section wherever the layout puts that.
    bar = ax.figure.colorbar(mesh, cax=ax.inset_axes((1.02, 0.0, 0.035, 0.82)))
    bar.set_label("displacement (mm)")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=4, borderaxespad=0.0)


def _draw_regions(ax: Axes, regions: NDArray[np.bool_], placed: Array) -> None:
    """Outline the regions where the deformation has taken them."""
    drawn = False
    for mask in regions:
        if mask.any() and not mask.all():
            dashes: Any = [(0, (1, 1.5))]
            style: dict[str, Any] = {"colors": "white", "linestyles": dashes, "linewidths": 1.3}
            ax.contour(placed[..., 0], placed[..., 2], mask.astype(float), [0.5], **style)
            drawn = True
    if drawn:  # a contour has no entry in a legend; grey stands for white there
        ax.plot([], [], color="0.55", linestyle=(0, (1, 1.5)), linewidth=1.3, label="regions")


def _draw_grid_lines(ax: Axes, grid: Array, placed: Array) -> None:
    """Draw material lines that were straight and evenly spaced in the undeformed tissue."""
    for axis in (0, 1):
        coordinate = grid[:, 0, 2] if axis == 0 else grid[0, :, 0]
        cells = np.round(coordinate / GRID_LINES)
        for line in np.unique(cells):
            i = int(np.abs(coordinate - line * GRID_LINES).argmin())
            row = placed[i] if axis == 0 else placed[:, i]
            ax.plot(row[:, 0], row[:, 2], color="white", linewidth=0.4, alpha=0.55)


def needle_outline(section: Section) -> Array:
    """Return the needle's outline in the x z plane with its bevel, (k, 2), m."""
    line = section.needle[:, [0, 2]]
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    # The normal that points to +x for a needle that points down.
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) * section.bevel_side
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    to_tip = np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
    shaft = to_tip >= section.bevel
    sharp = line + section.radius * normal
    blunt = (line - section.radius * normal)[shaft]
    return np.concatenate([sharp, blunt[::-1]])
