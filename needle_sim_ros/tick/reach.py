# SPDX-License-Identifier: Apache-2.0
"""How far the base may go in one time step of Newmark's method."""

from __future__ import annotations

import math
from typing import NamedTuple

from needle_sim_ros.errors import CommandError
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.waves import slowest_period

# how far the needle may go in and out in one time step of Newmark's method, in track spacings:
# beyond, the tissue's motion on the way is not followed
_FARTHEST_IN, _FARTHEST_OUT = 2, 4
# how far the base may go in one that is shorter than the slowest wave's period, in depths of
# the tissue: beyond, what the wave that it sends does to friction is not resolved
_FARTHEST = 0.02


class Reach(NamedTuple):
    """How far the base may go in one time step of Newmark's method while the needle is inserted.

    Attributes
    ----------
    spacing : float
        Of the track, m.
    way : float
        In any direction, turning included, m.
    why : str
        Where that is bounded.
    """

    spacing: float
    way: float
    why: str

    @classmethod
    def of(cls, scene: Scene) -> Reach:
        """Work out that of a scene."""
        period, depth = slowest_period(scene.tissue), scene.tissue.size[-1]
        if scene.solver.time_step >= period:
            return cls(scene.solver.track_spacing, math.inf, "")
        why = f"{_FARTHEST:.0%} of the tissue's depth, while its slowest wave takes {period:.3g} s"
        return cls(scene.solver.track_spacing, _FARTHEST * depth, why)

    def check(self, contact: ContactState, advance: float, way: float) -> None:
        """Raise CommandError where a time step takes the needle too far.

        Parameters
        ----------
        contact : ContactState
        advance, way : float
            Of the base in the step, along the needle and in all, m.
        """
        if not contact.inserted:
            return
        most = _FARTHEST_IN if advance > 0 else _FARTHEST_OUT
        if abs(advance) > most * self.spacing * (1 + 1e-9):
            raise CommandError(
                f"the needle would go {abs(advance):g} m in one time step, more than {most} times "
                f"solver.track_spacing ({self.spacing:g} m): solver.time_step is too long for it"
            )
        if way > self.way * (1 + 1e-9):
            raise CommandError(
                f"the base would go {way:g} m in one time step, more than {self.way:g} m, "
                f"{self.why}: solver.time_step is too long for it"
            )
