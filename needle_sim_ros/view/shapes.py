# SPDX-License-Identifier: Apache-2.0
"""Tissue, needle and forces as a few shapes for a 3D viewer; knows no ROS.

Every shape keeps its number, so that a viewer replaces it: one list of triangles instead
of many small shapes, which viewers stall on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import rotation_matrix
from needle_sim_ros.view.outlines import region_lines, tissue_surface

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation
    from needle_sim_ros.scene import Scene

Array = NDArray[np.float64]
Colour = tuple[float, float, float, float]

FORCE_SCALE = 0.02  # m of arrow per N
_FULL_SCALE = 2e-3  # m of displacement at the last colour
_NEEDLE: Colour = (0.75, 0.75, 0.78, 1.0)
_TRACK: Colour = (0.90, 0.62, 0.00, 1.0)
_MARKERS: Colour = (1.0, 1.0, 1.0, 1.0)
_FORCE: Colour = (0.84, 0.37, 0.00, 1.0)
_LINES: Colour = (0.55, 0.55, 0.55, 1.0)
_TISSUE_ALPHA = 0.7
# cividis at equal steps: matplotlib itself is too heavy for a node
_RAMP = np.array(
    [
        (0.000, 0.135, 0.305),
        (0.208, 0.254, 0.425),
        (0.387, 0.386, 0.434),
        (0.539, 0.522, 0.469),
        (0.736, 0.685, 0.432),
        (0.995, 0.909, 0.218),
    ]
)


class Kind(IntEnum):
    """How the points are meant; the numbers of `visualization_msgs/Marker`."""

    ARROW = 0
    LINE_STRIP = 4
    LINE_LIST = 5
    SPHERE_LIST = 7
    TRIANGLE_LIST = 11


@dataclass(frozen=True, eq=False)
class Shape:
    """One thing to show; without points it is to be taken away.

    Parameters
    ----------
    name : str
        What it is, the same each time.
    kind : Kind
    points : (n, 3) array
        Tissue frame, m.
    scale : tuple of float
        Width, diameter, or shaft and head of an arrow, m; 1 for triangles.
    colour : tuple of float
        Red, green, blue, opacity, 0 to 1.
    colours : (n, 4) array, optional
        By point, instead of `colour`.
    """

    name: str
    kind: Kind
    points: Array
    scale: tuple[float, float, float]
    colour: Colour
    colours: Array | None = None


class Shapes:
    """Makes the shapes of a scene's states.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._surface = tissue_surface(scene)
        self._lines = region_lines(scene).reshape(-1, 3)
        self._unit = 0.01 * max(scene.tissue.size)

    def of(self, seen: Observation, displacement: Callable[[Array], Array]) -> list[Shape]:
        """Return all shapes of one instant.

        Parameters
        ----------
        seen : Observation
        displacement : callable
            Gives the displacements (n, 3) of reference points (n, 3) at that instant, m;
            called once, since it costs a solve.
        """
        surface, inserted = self._surface, np.asarray(seen.contact_points, dtype=float)
        points = np.concatenate([surface.points, inserted.reshape(-1, 3)])
        moved = np.nan_to_num(displacement(points))
        placed, count = points + moved, len(surface.points)
        corners = surface.triangles.ravel()
        size = np.linalg.norm(moved[:count], axis=1)
        unit, width = self._unit, 2 * self._scene.needle.radius
        track = placed[count:] if len(inserted) > 1 else placed[:0]
        return [
            Shape(
                "tissue",
                Kind.TRIANGLE_LIST,
                placed[corners],
                (1.0, 1.0, 1.0),
                _NEEDLE,
                _colours(size)[corners],
            ),
            Shape("needle", Kind.LINE_STRIP, seen.needle_points, (width, 0.0, 0.0), _NEEDLE),
            Shape("track", Kind.LINE_STRIP, track, (0.5 * width, 0.0, 0.0), _TRACK),
            Shape("markers", Kind.SPHERE_LIST, seen.marker_positions, (unit,) * 3, _MARKERS),
            Shape("force", Kind.ARROW, _arrow(seen), (0.5 * unit, unit, 0.0), _FORCE),
            Shape("regions", Kind.LINE_LIST, self._lines, (0.1 * unit, 0.0, 0.0), _LINES),
        ]


def _arrow(seen: Observation) -> Array:
    """Return the arrow of the force on the needle, from its base, or nothing without one."""
    force = rotation_matrix(seen.base_orientation) @ seen.base_force
    if np.linalg.norm(force) < 1e-6:
        return np.zeros((0, 3))
    base = seen.base_position
    return np.array([base, base + FORCE_SCALE * force])


def _colours(size: Array) -> Array:
    """Return red, green, blue, opacity of displacement magnitudes (n,), m."""
    place = np.clip(size / _FULL_SCALE, 0.0, 1.0) * (len(_RAMP) - 1)
    steps = np.arange(len(_RAMP))
    colours = np.full((len(size), 4), _TISSUE_ALPHA)
    for k in range(3):
        colours[:, k] = np.interp(place, steps, _RAMP[:, k])
    return colours
