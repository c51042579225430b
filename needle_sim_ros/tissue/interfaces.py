# SPDX-License-Identifier: Apache-2.0
"""Grid lines on the plane faces of regions, so that no element holds two materials."""

from __future__ import annotations

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Region, Scene

# of the neighbouring spacing: a line this near is moved, else one is added
_NEAR = 0.25


def planes(scene: Scene) -> tuple[list[float], list[float], list[float]]:
    """Return where regions of other stiffness or density end: x, y, z, m, ascending.

    Faces of boxes, half spaces and ends of cylinders across a coordinate axis; curved and
    slanting interfaces lie within elements, which take the material at each quadrature point.
    """
    found: tuple[set[float], set[float], set[float]] = (set(), set(), set())
    for region in scene.tissue.regions:
        if (region.youngs_modulus, region.poisson_ratio, region.density) == (None, None, None):
            continue
        for axis, values in enumerate(_faces(region)):
            found[axis].update(values)
    x, y, z = (sorted(values) for values in found)
    return x, y, z


def _faces(region: Region) -> list[list[float]]:
    faces: list[list[float]] = [[], [], []]
    if region.shape == "box":
        for axis in range(3):
            half = region.size[axis] / 2
            faces[axis] = [region.center[axis] - half, region.center[axis] + half]
    elif region.shape in ("half_space", "cylinder"):
        direction = np.abs(region.axis) / np.linalg.norm(region.axis)
        axis = int(direction.argmax())
        if direction[axis] > 1 - 1e-9:
            half = 0.0 if region.shape == "half_space" else region.size[2] / 2
            faces[axis] = [region.center[axis] - half, region.center[axis] + half]
    return faces


def fitted(lines: Vector, at: list[float]) -> Vector:
    """Return ascending lines of which one stands at each of the values between the ends."""
    taken: set[float] = {float(lines[0]), float(lines[-1])}
    slack = 1e-9 * (lines[-1] - lines[0])
    for value in at:
        if not lines[0] + slack < value < lines[-1] - slack:
            continue
        nearest = int(np.abs(lines - value).argmin())
        other = nearest + (1 if value > lines[nearest] else -1)
        spacing = abs(lines[min(max(other, 0), len(lines) - 1)] - lines[nearest])
        distance = abs(lines[nearest] - value)
        if float(lines[nearest]) not in taken and distance <= max(_NEAR * spacing, slack):
            lines = lines.copy()
            lines[nearest] = value
        elif distance > slack:
            lines = np.sort(np.append(lines, value))
        taken.add(float(value))
    return lines
