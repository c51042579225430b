# SPDX-License-Identifier: Apache-2.0
"""What is asked of a plan: a target, what may vary, and limits; checked before any work."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.planning.keep_out import clearance, distance
from needle_sim_ros.planning.rollout import Outcome
from needle_sim_ros.scene import Region, Scene

VARIABLES = ("entry", "inclination", "roll", "schedule", "offset")
_OF_THREE = ("roll", "schedule")
# how near the tip has to come, m, by dimension
TOLERANCE = {2: 1e-4, 3: 5e-4}


@dataclass(frozen=True)
class Limits:
    """What an insertion must not exceed.

    Attributes
    ----------
    force : float
        Base force, N.
    deflection : float
        Of the tip from the undeflected needle, m.
    clearance : float
        Least distance between the needle's surface and the regions, m.
    keep_out : tuple of Region
    """

    force: float = math.inf
    deflection: float = math.inf
    clearance: float = 0.0
    keep_out: tuple[Region, ...] = ()

    def violations(self, outcome: Outcome, radius: float) -> list[float]:
        """Return by how much each limit is exceeded, in parts of it (clearance: of 1 mm)."""
        over = []
        if math.isfinite(self.force):
            over.append(max(0.0, outcome.peak_force / self.force - 1))
        if math.isfinite(self.deflection):
            over.append(max(0.0, outcome.deflection / self.deflection - 1))
        if self.keep_out:
            free = clearance(outcome.track, self.keep_out, radius)
            over.append(max(0.0, 1e3 * (self.clearance - free)))
        return over


@dataclass(frozen=True)
class Task:
    """A target and what may be done to hit it.

    Attributes
    ----------
    target : tuple of 3 floats
        Reference position in the tissue frame, m.
    vary : tuple of str
        Of :data:`VARIABLES`; the depth always varies.
    limits : Limits
    tolerance : float
        Of the miss, m.
    """

    target: tuple[float, float, float]
    vary: tuple[str, ...] = ("entry",)
    limits: Limits = Limits()
    tolerance: float = 1e-4


def read_target(text: str, scene: Scene) -> tuple[float, float, float]:
    """Return a target given as the number of a marker, from 1, or as x,y,z in m."""
    parts = text.split(",")
    try:
        if len(parts) == 1:
            number = int(text)
            if not 1 <= number <= len(scene.markers):
                raise NeedleSimError(
                    f"--target {number}: the scene has the markers 1 to {len(scene.markers)}"
                )
            x, y, z = scene.markers[number - 1]
        else:
            x, y, z = (float(part) for part in parts)
    except ValueError:
        raise NeedleSimError(f"--target {text}: must be a marker's number or x,y,z in m") from None
    return x, y, z


def check(task: Task, scene: Scene) -> None:
    """Refuse what cannot be planned.

    Raises
    ------
    NeedleSimError
        Naming what is wrong, and what is allowed.
    """
    _check_target(np.array(task.target), scene)
    unknown = [name for name in task.vary if name not in VARIABLES]
    if unknown or not task.vary:
        given = ",".join(task.vary) or "nothing"
        raise NeedleSimError(f"--vary {given}: may name {', '.join(VARIABLES)}")
    planar = [name for name in task.vary if name in _OF_THREE]
    if scene.dimension == 2 and planar:
        raise NeedleSimError(f"--vary {planar[0]}: a 2D needle cannot roll; needs dimension 3")
    _check_positive("tolerance", task.tolerance)
    _check_limits(task, scene)


def _check_target(target: Vector, scene: Scene) -> None:
    where = ", ".join(f"{x:g}" for x in target)
    if not np.isfinite(target).all():
        raise NeedleSimError(f"target {where}: must be finite")
    size = scene.tissue.size
    if target[2] > 0:
        raise NeedleSimError(f"target {where}: lies {target[2]:g} m above the surface, z = 0")
    if scene.dimension == 2 and abs(target[1]) > 1e-12:
        raise NeedleSimError(f"target {where}: a 2D scene has y = 0")
    half_y = size[1] / 2 if scene.dimension == 3 else 0.0
    inside = abs(target[0]) < size[0] / 2 and abs(target[1]) <= half_y
    if not inside or not -size[-1] < target[2] < 0:
        raise NeedleSimError(
            f"target {where}: outside the tissue, |x| < {size[0] / 2:g}"
            + (f", |y| < {half_y:g}" if scene.dimension == 3 else "")
            + f", {-size[-1]:g} < z < 0 m"
        )
    if -target[2] >= scene.needle.length:
        raise NeedleSimError(
            f"target {where}: deeper than the needle is long, {scene.needle.length:g} m"
        )


def _check_limits(task: Task, scene: Scene) -> None:
    limits = task.limits
    _check_positive("force limit", limits.force)
    _check_positive("deflection limit", limits.deflection)
    if not (math.isfinite(limits.clearance) and limits.clearance >= 0):
        raise NeedleSimError(f"clearance {limits.clearance:g} m: must be finite and >= 0")
    if limits.clearance > 0 and not limits.keep_out:
        raise NeedleSimError(f"clearance {limits.clearance:g} m: no region is kept out of")
    if not scene.tissue.regions:
        puncture = scene.interaction.puncture.force or 0.0
        if limits.force < puncture:
            raise NeedleSimError(
                f"force limit {limits.force:g} N: contradicts interaction.puncture.force, "
                f"{puncture:g} N, below which the needle does not enter"
            )
    _check_regions(task, limits.keep_out, scene)


def _check_regions(task: Task, regions: Sequence[Region], scene: Scene) -> None:
    target = np.array([task.target])
    for region in regions:
        free = float(distance(target, region)[0])
        where = ", ".join(f"{x:g}" for x in task.target)
        if free <= 0:
            raise NeedleSimError(f"target {where}: inside the keep-out region {region.name!r}")
        needed = task.limits.clearance + scene.needle.radius
        if free < needed:
            raise NeedleSimError(
                f"clearance {task.limits.clearance:g} m: contradicts the target, {free:g} m from "
                f"the keep-out region {region.name!r}; the needle's radius is "
                f"{scene.needle.radius:g} m"
            )


def _check_positive(name: str, value: float) -> None:
    if not value > 0:
        raise NeedleSimError(f"{name} {value:g}: must be > 0")
