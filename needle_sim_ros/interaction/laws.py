# SPDX-License-Identifier: Apache-2.0
"""How much the tissue resists: friction per length, cutting, puncture, by place (Fig. 3)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Interaction, Region, Scene
from needle_sim_ros.tissue.material import in_region, in_space


@dataclass(frozen=True)
class LocalLaws:
    """Limits at one place of the tissue.

    Attributes
    ----------
    static, kinetic : float
        Friction per length, N/m.
    cutting, puncture : float
        Axial force at the tip, N.
    membrane : int
        Number of the region that says the puncture force; -1 outside of such.
    """

    static: float
    kinetic: float
    cutting: float
    puncture: float
    membrane: int = -1


class Laws:
    """The laws of a scene.

    Parameters
    ----------
    scene : Scene
        Its interaction and the regions that override it.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.interaction: Interaction = scene.interaction
        self._regions: tuple[Region, ...] = scene.tissue.regions
        self.vary = bool(self._regions)
        self._common = self._outside()

    def _outside(self) -> LocalLaws:
        """Return the limits where there is no region."""
        friction, cutting = self.interaction.friction, self.interaction.cutting
        puncture = self.interaction.puncture.force
        return LocalLaws(
            friction.static,
            friction.kinetic,
            cutting.force,
            cutting.force if puncture is None else puncture,
        )

    def at(self, point: Vector) -> LocalLaws:
        """Return the limits at a point of the mesh, shape (d,)."""
        if not self.vary:
            return self._common
        limits: dict[str, Any] = asdict(self._common)
        world = in_space(point)
        for number, region in enumerate(self._regions):
            if not in_region(self._scene, region, world):
                continue
            own = {
                "static": region.friction_static,
                "kinetic": region.friction_kinetic,
                "cutting": region.cutting_force,
                "puncture": region.puncture_force,
                "membrane": None if region.puncture_force is None else number,
            }
            limits |= {name: value for name, value in own.items() if value is not None}
        limits["static"] = max(limits["static"], limits["kinetic"])
        limits["puncture"] = max(limits["puncture"], limits["cutting"])
        return LocalLaws(**limits)

    def friction(self, static: Vector, kinetic: Vector, slip: Vector) -> Vector:
        """Return the friction limit per length after a slip, N/m, shapes (n,).

        Static friction falls to kinetic over the weakening distance (segments DE, FG).
        """
        left = slip * (-1.0 / self.interaction.friction.weakening_distance)
        left += 1.0
        np.maximum(left, 0.0, out=left)
        left *= static - kinetic
        left += kinetic
        return left

    def cutting(self, force: float, depth: float) -> float:
        """Return the cutting force at a depth, N, with its periodic ripple (line AB)."""
        ripple = self.interaction.cutting.ripple
        if ripple.amplitude == 0:
            return force
        return force * (1 + ripple.amplitude * math.sin(2 * math.pi * depth / ripple.wavelength))

    def relaxed(self, force: float, duration: float) -> float:
        """Return a tip force after a hold of some duration (t1 to t2), N."""
        return force * math.exp(-duration / self.interaction.cutting.relaxation_time)
