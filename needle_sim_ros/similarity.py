# SPDX-License-Identifier: Apache-2.0
"""Similar scenes: all forces and stiffnesses divided by one factor, displacements the same.

A tissue s times as stiff as the factorised one is simulated, quasi-statically, as the
factorised one, with needle rigidity, friction, presliding stiffness, cutting and puncture
forces divided by s, and forces multiplied by s. This is exact but for rounding.
"""

from __future__ import annotations

from dataclasses import replace

from needle_sim_ros.scene import Region, Scene


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
