# SPDX-License-Identifier: Apache-2.0
"""Simulators of a scene with other parameters, without another factorisation.

Another Young's modulus is another similar scene on the factorised tissue (similarity.py).
"""

from __future__ import annotations

from collections.abc import Callable

from needle_sim_ros.identify.parameters import Values, with_values
from needle_sim_ros.scene import Scene
from needle_sim_ros.similarity import softened
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
