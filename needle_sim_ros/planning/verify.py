# SPDX-License-Identifier: Apache-2.0
"""A plan in the full model: the scene's own mesh, dynamics and tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator


@dataclass(frozen=True)
class Verified:
    """What a run of the planned protocol gave at the end of the insertion.

    Attributes
    ----------
    tip, target : ndarray, shape (3,)
        m.
    peak_force : float
        N.
    deflection : float
        Largest of the tip, m.
    """

    tip: Vector
    target: Vector
    peak_force: float
    deflection: float

    @property
    def miss(self) -> float:
        """Distance of tip and displaced target, m."""
        return float(np.linalg.norm(self.tip - self.target))


def protocol_scene(scene: Scene, insertion: Insertion, target: tuple[float, ...]) -> Scene:
    """Return the scene of an insertion, with the target as its last marker."""
    return insertion.scene_of(scene).with_changes(
        {"markers": [*(list(m) for m in scene.markers), list(target)]}
    )


class FullModel:
    """The scene's own mesh, dynamics and tick, for insertions that differ little.

    Parameters
    ----------
    planned : Scene
        Of :func:`protocol_scene`: the mesh is graded to its path.
    """

    def __init__(self, planned: Scene) -> None:
        self._simulator = Simulator(planned)

    def run(
        self, planned: Scene, tick: Callable[[int, int], object] = lambda done, total: None
    ) -> Verified:
        """Run a planned scene's protocol.

        Parameters
        ----------
        planned : Scene
            Of :func:`protocol_scene`, of the same scene and target.
        tick : callable
            Called with (done, total) ticks.
        """
        simulator, step = self._simulator.variant(planned), planned.solver.time_step
        commands = protocol_commands(planned.protocol, step)
        force = deflection = 0.0
        for number, command in enumerate(commands):
            seen = simulator.step(command, step)
            force = max(force, float(np.linalg.norm(seen.base_force)))
            deflection = max(deflection, math.hypot(*seen.tip_deflection))
            tick(number + 1, len(commands))
        return Verified(seen.tip_position, seen.marker_positions[-1], force, deflection)


def verify(
    planned: Scene, tick: Callable[[int, int], object] = lambda done, total: None
) -> Verified:
    """Run a planned scene's protocol in the scene's own model, on the mesh of its own path.

    Parameters
    ----------
    planned : Scene
        Of :func:`protocol_scene`.
    tick : callable
        Called with (done, total) ticks.
    """
    return FullModel(planned).run(planned, tick)
