# SPDX-License-Identifier: Apache-2.0
"""Settings that the accuracy benchmark compares, and its references."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from needle_sim_ros.errors import SceneError
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.mesh import spacings

Changes = dict[str, Any]

# Modes of the reduced runs where the scene names none.
REDUCED_MODES = 60


@dataclass(frozen=True)
class Variant:
    """Settings of one run.

    Attributes
    ----------
    method : str
        ``quasi_static``, ``newmark`` (every unknown) or ``reduced`` (modes).
    name : str
        What differs from the default.
    changes : dict
        Dotted keys of the scene to values.
    """

    method: str
    name: str
    changes: Changes

    @property
    def settings(self) -> str:
        """Return the changes as ``--set`` takes them."""
        return " ".join(f"{key}={_shown(value)}" for key, value in self.changes.items())


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def method_changes(scene: Scene, method: str) -> Changes:
    """Return the keys that choose a method."""
    if method == "quasi_static":
        return {"solver.dynamics": "quasi_static"}
    modes = 0 if method == "newmark" else scene.solver.modes or REDUCED_MODES
    return {"solver.dynamics": "newmark", "solver.modes": modes}


def own_method(scene: Scene) -> str:
    """Return the method that the scene itself chooses."""
    if scene.solver.dynamics == "quasi_static":
        return "quasi_static"
    return "reduced" if scene.solver.modes else "newmark"


def refined(scene: Scene, across: float, along: float, track: float, growth: float) -> Changes:
    """Return the keys of a mesh with the scene's spacings multiplied by factors."""
    wide, deep, _ = spacings(scene)
    return {
        "tissue.mesh.spacing_across": wide * across,
        "tissue.mesh.spacing_along": deep * along,
        "tissue.mesh.growth": growth,
        "solver.track_spacing": scene.solver.track_spacing * track,
    }


def references(scene: Scene, quick: bool) -> tuple[Changes, Changes]:
    """Return the settings of the reference and of the level that shows it converged."""
    if quick:
        return refined(scene, 1.0, 0.5, 0.5, 1.5), refined(scene, 1.0, 0.75, 0.75, 1.5)
    return refined(scene, 0.5, 0.25, 0.25, 1.25), refined(scene, 0.5, 0.5, 0.5, 1.25)


def variants(scene: Scene, quick: bool) -> list[Variant]:
    """Return the runs to compare, each method's default first.

    Settings that the scene refuses, e.g. a mesh too coarse for the track, are left out.
    """
    mesh, step = scene.tissue.mesh, scene.solver.time_step
    others = [e for e in ("quad2", "quad1", "tri2", "tri1") if e != mesh.element]
    elements: dict[str, Changes] = {e: {"tissue.mesh.element": e} for e in others}
    meshes: dict[str, Changes] = {
        "mesh x 2": refined(scene, 2.0, 2.0, 1.0, mesh.growth),
        "mesh across x 2": refined(scene, 2.0, 1.0, 1.0, mesh.growth),
        "growth 3": {"tissue.mesh.growth": 3.0},
        "growth 2": {"tissue.mesh.growth": 2.0},
    }
    if not quick:
        meshes["growth 1.25"] = {"tissue.mesh.growth": 1.25}
        meshes["mesh along x 1/2"] = refined(scene, 1.0, 0.5, 1.0, mesh.growth)
        meshes["mesh x 1/2"] = refined(scene, 0.5, 0.5, 1.0, mesh.growth)
        fine = refined(scene, 0.5, 0.5, 1.0, mesh.growth)
        elements |= {f"{e}, mesh x 1/2": {"tissue.mesh.element": e, **fine} for e in others}
    tracks: dict[str, Changes] = {
        "track x 4, mesh x 2 along": refined(scene, 1.0, 4.0, 4.0, 2.0),
        "track x 2": refined(scene, 1.0, 2.0, 2.0, mesh.growth),
    }
    if not quick:
        tracks["track x 2, growth 2"] = refined(scene, 1.0, 2.0, 2.0, 2.0)
        tracks["track x 1/2"] = refined(scene, 1.0, 0.5, 0.5, mesh.growth)
    steps: dict[str, Changes] = {
        "time step x 4": {"solver.time_step": 4 * step},
        "time step x 2": {"solver.time_step": 2 * step},
        "time step x 1/2": {"solver.time_step": step / 2},
    }
    modes: dict[str, Changes] = {
        f"{n} modes": {"solver.modes": n} for n in ((20, 120) if quick else (5, 20, 40, 120, 240))
    }
    plan = {
        "quasi_static": {**elements, **meshes, **tracks, **steps},
        "newmark": {} if quick else {**meshes, **tracks, **steps},
        "reduced": {**modes, **(tracks | steps if not quick else {})},
    }
    runs = []
    for method, settings in plan.items():
        own = method_changes(scene, method)
        default: dict[str, Changes] = {"default": {}}
        for name, changes in (default | settings).items():
            runs.append(Variant(method, name, {**own, **changes}))
    return [run for run in runs if admissible(scene, run.changes)]


def admissible(scene: Scene, changes: Changes) -> bool:
    """Return whether a scene allows changes."""
    try:
        scene.with_changes(changes)
    except SceneError:
        return False
    return True
