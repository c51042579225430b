# SPDX-License-Identifier: Apache-2.0
"""The balance of an inserted needle by compiled code, where there is any.

What Balance does in hundreds of calls of numpy, `_balance.c` does in two, to the same rounding.
"""

from __future__ import annotations

import numpy as np

from needle_sim_ros import compiled
from needle_sim_ros.interaction.friction import fitted
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.solution import BalanceSolution
from needle_sim_ros.interaction.task import InsertedTask
from needle_sim_ros.scene import Scene

try:
    from needle_sim_ros.interaction import _balance
except ImportError:  # built without a compiler, or run from the source
    _balance = None  # type: ignore[assignment]

# rows of what the compiled code writes for each point, and how many there are
_FRICTION, _SHARE, _STRAIN, _SLIP, _SLID, _ROWS = 0, 1, 2, 3, 4, 11
_NO_HOLD = (None,) * 7
_REACH = 6  # number of the step's number that the first part makes out


def available() -> bool:
    """Return whether there is compiled code, and it is not switched off."""
    return _balance is not None and compiled.wanted()


class CompiledBalance:
    """Balances an inserted needle as Balance does.

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
        rigidity = needle.flexural_rigidity
        spacing = scene.solver.track_spacing
        self._numbers = (spacing, bevel, needle.length, rigidity, grip, tip_softness)
        self._tolerance = scene.solver.tolerance

    def solve(self, laws: Laws, task: InsertedTask) -> BalanceSolution | None:
        """Return the solution; None where it takes more patience."""
        track, step, free, moved, memory, status, depth, held, hold, reach, limit = task
        pose, table, friction = step.after, track.table, laws.interaction.friction
        n, m, axes = len(status) - 1, len(pose.lateral), pose.terms
        rows, hold_rows = np.empty((_ROWS, n)), np.empty((2, held))
        lateral, forces, after = np.empty((m, held)), np.empty_like(free), np.empty_like(free)
        numbers = (
            depth,
            step.advance,
            memory.pace(step.advance),
            memory.lapse(step.duration),
            step.duration,
            limit,
            reach,
            *self._numbers,
            friction.presliding_stiffness,
            friction.weakening_distance,
            friction.healing_time,
            self._tolerance,
        )
        common = (
            pose.origin,
            pose.axial,
            pose.lateral,
            track.points,
            free,
            fitted(memory.slip, n),
            fitted(memory.strain, n),
            status,
            table.store,
            rows,
            hold_rows,
            lateral,
            forces,
            after,
        )
        guess: tuple[object, ...] = _NO_HOLD
        if hold is not None:
            guess = (
                tuple([table.along(axes, a, m) for a in range(m)]),
                hold.factor.T,
                hold.arclength,
                hold.softness,
                *hold.changes(),
            )
        holds, reach, tip, overlap, lack, state, solves = _balance.slide(
            numbers,
            *common,
            moved,
            track.static,
            track.kinetic,
            fitted(memory.slid, n),
            *guess,
        )
        residual = 0.0
        if holds:
            if state != status[-1]:
                status = status.copy()
                status[-1] = state
        else:
            found_status = np.empty_like(status)
            found = _balance.bounded(
                (*numbers[:_REACH], reach, *numbers[_REACH + 1 :]),
                *common,
                tuple([table.along(axes, a, b) for a in range(m + 1) for b in range(a + 1)]),
                found_status,
            )
            if found is None:
                return None
            tip, overlap, lack, residual, solves = found
            status = found_status
        return BalanceSolution(
            n,
            lateral,
            rows[_FRICTION],
            tip,
            hold_rows[0],
            hold_rows[1],
            rows[_SHARE],
            rows[_STRAIN],
            rows[_SLIP],
            rows[_SLID],
            step.advance,
            step.duration,
            after,
            forces,
            status,
            solves,
            residual,
            overlap,
            lack,
        )
