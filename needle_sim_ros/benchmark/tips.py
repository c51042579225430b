# SPDX-License-Identifier: Apache-2.0
"""How far needles with other tips deflect: one tip fitted, the others predicted.

Rand et al. (2016), 10.5812/aapm.36607, drove 22 G spinal needles 80 mm into ballistic gel. The
scene's deviation angle is fitted to the Quincke tip. For the others it follows from the bevel
angle: a face inclined by beta to the axis that moves through a medium is pushed aside in
proportion to sin(beta) cos(beta), so tan(deviation) = c sin(2 beta), c from the fitted tip.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.benchmark.trajectory import hurried
from needle_sim_ros.errors import SceneError
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Progress = Callable[[int, int], None]

SCENE = "bevel_gelatin_22g"
_HASTE, _QUICK_HASTE = 4.0, 16.0
_QUICK: dict[str, Any] = {
    "tissue.mesh.spacing_across": 2.0e-3,
    "tissue.mesh.spacing_along": 2.0e-3,
    "solver.track_spacing": 2.0e-3,
    "markers": [],
}


class Tip(NamedTuple):
    """A tip: bevel angle, deg (None: symmetric), published deflection and deviation of it, mm."""

    name: str
    bevel: float | None
    published: float
    spread: float
    note: str


# No bevel angle is published with the deflections, nor was one found elsewhere with a source:
# all are assumed. The first tip is the fitted one, at the scene's own angle.
TIPS = (
    Tip("Quincke", None, 8.89, 0.17, "fitted; bevel angle of the scene, assumed"),
    Tip("short bevel", 30.0, 9.96, 0.77, "bevel angle assumed: 30 to 45 deg are called short"),
    Tip("Chiba", 25.0, 7.71, 1.16, "bevel angle assumed"),
    Tip("Tuohy", 20.0, 7.64, 0.16, "assumed as Quincke; its tip is curved, which the rule ignores"),
    Tip("Whitacre", None, 0.73, 0.34, "pencil point: symmetric, no deviation"),
)


def deviation(scene: Scene, bevel: float) -> float:
    """Return the deviation angle of another bevel angle, rad, by the rule and the scene's fit."""
    tip = scene.needle.tip
    ratio = math.sin(2 * bevel) / math.sin(2 * tip.bevel_angle)
    return math.atan(math.tan(tip.deviation_angle) * ratio)


def tips(scene: Scene, quick: bool = False, progress: Progress | None = None) -> BenchmarkResult:
    """Predict the deflection of the published tips at the end of the insertion.

    Parameters
    ----------
    scene : Scene
        ``bevel_gelatin_22g``; keys of it may be changed.
    quick : bool
        On a coarser mesh and track, the protocol sixteen times as fast instead of four.
    progress : callable, optional
        Called with (done, total) tips.

    Returns
    -------
    BenchmarkResult
        Figures ``tips.<name>_mm`` and, in published standard deviations,
        ``tips.<name>_deviations`` from the published mean.

    Raises
    ------
    SceneError
        When it is another scene.
    """
    if scene.name != SCENE:
        raise SceneError("name", scene.name, f"must be {SCENE}: its needles are the published ones")
    scene = hurried(scene, _QUICK_HASTE if quick else _HASTE)
    if quick:
        scene = scene.with_changes(_QUICK)
    result = BenchmarkResult("tips", scene.name)
    for number, tip in enumerate(TIPS):
        own = _with_tip(scene, tip, fitted=number == 0)
        found = 1e3 * _deflection(own)
        off = (found - tip.published) / tip.spread
        result.table.append(_row(tip, own, found, off))
        key = tip.name.lower().replace(" ", "_")
        result.figures[f"tips.{key}_mm"] = found
        result.figures[f"tips.{key}_deviations"] = off
        if progress is not None:
            progress(number + 1, len(TIPS))
    return result


def _with_tip(scene: Scene, tip: Tip, fitted: bool) -> Scene:
    if fitted:
        return scene
    if tip.bevel is None:
        return scene.with_changes({"needle.tip.deviation_angle": 0.0})
    bevel = math.radians(tip.bevel)
    changes = {"bevel_angle": bevel, "deviation_angle": deviation(scene, bevel)}
    return scene.with_changes({f"needle.tip.{key}": value for key, value in changes.items()})


def _deflection(scene: Scene) -> float:
    """Return how far the tip is from the undeflected needle when the insertion ends, m."""
    simulator, deepest, aside = Simulator(scene), -1.0, 0.0
    for command in protocol_commands(scene.protocol, scene.solver.time_step):
        seen = simulator.step(command, scene.solver.time_step)
        if seen.insertion_depth <= deepest + 1e-9 and deepest > 0:
            break
        deepest, aside = seen.insertion_depth, float(np.linalg.norm(seen.tip_deflection))
    return aside


def _row(tip: Tip, scene: Scene, found: float, off: float) -> Row:
    return {
        "section": "deflection of the tip at the end of the insertion",
        "tip": tip.name,
        "bevel_deg": None if not scene.needle.tip.deviation_angle else _degrees(scene, "bevel"),
        "deviation_deg": _degrees(scene, "deviation"),
        "found_mm": found,
        "published_mm": tip.published,
        "standard_deviation_mm": tip.spread,
        "off_in_deviations": off,
        "note": tip.note,
    }


def _degrees(scene: Scene, which: str) -> float:
    return math.degrees(getattr(scene.needle.tip, f"{which}_angle"))
