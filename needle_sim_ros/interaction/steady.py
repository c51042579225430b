# SPDX-License-Identifier: Apache-2.0
"""The balance of a needle that goes on sliding, by compiled code where there is any.

Most ticks slide, with every point weakened and at its bound. What Balance does then in a
hundred calls of numpy, `_steady.c` does in one, to the same rounding.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.friction import FrictionMemory, fitted
from needle_sim_ros.interaction.lateral_hold import LateralHold
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.solution import BalanceSolution
from needle_sim_ros.interaction.track import Track
from needle_sim_ros.scene import Scene

if TYPE_CHECKING:
    from needle_sim_ros.interaction.contact import Step

try:
    from needle_sim_ros.interaction import _steady
except ImportError:  # built without a compiler, or run from the source
    _steady = None  # type: ignore[assignment]

SWITCH = "NEEDLE_SIM_COMPILED"  # environment variable; `off` keeps to numpy
# rows of what the compiled code writes for each point, and how many there are
_FRICTION, _SHARE, _STRAIN, _SLIP, _SLID, _ROWS = 0, 1, 2, 3, 4, 9


def available() -> bool:
    """Return whether there is compiled code, and it is not switched off."""
    return _steady is not None and os.environ.get(SWITCH, "on").lower() != "off"


class SteadySliding:
    """Solves for steps in which every point, and the tip, go on as they did.

    Parameters
    ----------
    scene : Scene
    bevel : float
        Length over which the tip force is spread, m.
    grip : float
        Lateral stiffness of the tissue per length of needle, N/m per m.
    tip_softness : float
        Of the tip's own contact, m/N.
    """

    def __init__(self, scene: Scene, bevel: float, grip: float, tip_softness: float) -> None:
        needle = scene.needle
        self._before = (scene.solver.track_spacing, bevel, needle.length)
        self._after = (needle.flexural_rigidity, grip, tip_softness)
        self._tolerance = scene.solver.tolerance

    def solve(
        self,
        laws: Laws,
        track: Track,
        step: Step,
        free: Vector,
        moved: Vector,
        memory: FrictionMemory,
        status: NDArray[np.int8],
        depth: float,
        hold: LateralHold,
        reach: float,
        limit: float,
    ) -> BalanceSolution | None:
        """Return the solution; None where something sticks, turns round or is let go.

        Parameters
        ----------
        laws : Laws
        track : Track
        step : Step
            In which the base does not turn.
        free, moved : ndarray, shape (laid, d)
            Displacement of the track points without forces, and before the step, m.
        memory : FrictionMemory
            Of the step before.
        status : ndarray of int8, shape (n + 1,)
            Bounds that held: friction of each point, and last the tip.
        depth : float
            Of the tip, m.
        hold : LateralHold
            Of the points that the tip has passed.
        reach : float
            How far the tip would be beyond its place on the undeformed track, m.
        limit : float
            Largest tip force, N.
        """
        pose, table, friction = step.after, track.table, laws.interaction.friction
        n, held, m = len(status) - 1, len(hold.arclength), len(pose.lateral)
        rows, held_rows = np.empty((_ROWS, n)), np.empty((2, held))
        lateral, forces, after = np.empty((m, held)), np.empty_like(free), np.empty_like(free)
        axes = pose.terms
        found = _steady.solve(
            (
                depth,
                step.advance,
                limit,
                reach,
                *self._before,
                *self._after,
                friction.presliding_stiffness,
                friction.weakening_distance,
                self._tolerance,
            ),
            pose.origin,
            pose.axial,
            pose.lateral,
            track.points,
            track.kinetic,
            free,
            moved,
            fitted(memory.slip, n),
            fitted(memory.strain, n),
            status,
            table.store,
            tuple([table.along(axes, a, m) for a in range(m)]),
            hold.factor.T,
            hold.arclength,
            hold.softness,
            *hold.changes(),
            rows,
            held_rows,
            lateral,
            forces,
            after,
        )
        if found is None:
            return None
        tip, overlap = found
        return BalanceSolution(
            n,
            lateral,
            rows[_FRICTION],
            tip,
            held_rows[0],
            held_rows[1],
            rows[_SHARE],
            rows[_STRAIN],
            rows[_SLIP],
            rows[_SLID],
            step.advance,
            after,
            forces,
            status,
            1,
            0.0,
            overlap,
        )
