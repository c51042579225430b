# SPDX-License-Identifier: Apache-2.0
"""Simulators of a scene with other parameters, without another factorisation.

Quasi-static forces and stiffnesses may all be divided by the same factor s: displacements
stay as they are. A tissue s times as stiff as the factorised one is therefore simulated as
the factorised one, with needle rigidity, friction, presliding stiffness, cutting and
puncture forces divided by s, and forces multiplied by s. This is exact but for rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from needle_sim_ros.identify.parameters import Values, with_values
from needle_sim_ros.scene import Region, Scene
from needle_sim_ros.simulator import Simulator


def quasi_static(scene: Scene) -> Scene:
    """Return the scene without inertia, in which it is identified."""
    if scene.solver.dynamics == "quasi_static":
        return scene
    return scene.with_changes({"solver.dynamics": "quasi_static", "solver.modes": 0})


class ParametricModel:
    """A scene whose parameters change and whose tissue is prepared once.

    Parameters
    ----------
    scene : Scene
        With Newmark every other Young's modulus is prepared anew, as inertia and damping
        do not grow with it.
    progress : callable, optional
        Called with (done, total) while the tissue is prepared.
    """

    def __init__(self, scene: Scene, progress: Callable[[int, int], None] | None = None) -> None:
        self.scene = scene
        self._similar = scene.solver.dynamics == "quasi_static"
        self._base = Simulator(scene, progress)

    def at(self, values: Values) -> tuple[Simulator, float]:
        """Return a simulator for parameter values, and what to multiply its forces by."""
        scene = with_values(self.scene, values)
        ratio = scene.tissue.youngs_modulus / self.scene.tissue.youngs_modulus
        if not self._similar:
            same = scene.tissue == self.scene.tissue
            return (self._base.variant(scene) if same else Simulator(scene)), 1.0
        return self._base.variant(softened(scene, ratio, self.scene)), ratio


def softened(scene: Scene, ratio: float, reference: Scene) -> Scene:
    """Return the similar scene in which all forces are `ratio` times smaller.

    Parameters
    ----------
    scene : Scene
    ratio : float
    reference : Scene
        Whose moduli the tissue of the new scene has, to the last bit.
    """
    laws = scene.interaction
    friction = replace(
        laws.friction,
        static=laws.friction.static / ratio,
        kinetic=laws.friction.kinetic / ratio,
        presliding_stiffness=laws.friction.presliding_stiffness / ratio,
    )
    cutting = replace(laws.cutting, force=laws.cutting.force / ratio)
    puncture = replace(laws.puncture, force=_part(laws.puncture.force, ratio))
    regions = tuple(
        _softened_region(mine, ratio, other.youngs_modulus)
        for mine, other in zip(scene.tissue.regions, reference.tissue.regions, strict=True)
    )
    return replace(
        scene,
        tissue=replace(reference.tissue, regions=regions),
        needle=replace(scene.needle, youngs_modulus=scene.needle.youngs_modulus / ratio),
        interaction=replace(laws, friction=friction, cutting=cutting, puncture=puncture),
    )


def _softened_region(region: Region, ratio: float, modulus: float | None) -> Region:
    return replace(
        region,
        youngs_modulus=modulus,
        friction_static=_part(region.friction_static, ratio),
        friction_kinetic=_part(region.friction_kinetic, ratio),
        cutting_force=_part(region.cutting_force, ratio),
        puncture_force=_part(region.puncture_force, ratio),
    )


def _part(value: float | None, ratio: float) -> float | None:
    return None if value is None else value / ratio
