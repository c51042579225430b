# SPDX-License-Identifier: Apache-2.0
"""What the balance of a step is, however it was found."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector


class BalanceSolution(NamedTuple):
    """Forces and kinematics of a step: the last fields of ContactState, in its order, and more.

    Attributes
    ----------
    overlap : float
        How far the tip wants beyond the end of the track (negative: short of it), m.
    lack : float
        How far back the tip would bear its limit, at most, m; 0 where it does.
    """

    active: int
    lateral: Vector
    friction: Vector
    tip: float
    arclength: Vector
    softness: Vector
    share: Vector
    strain: Vector
    slip: Vector
    slid: Vector
    advance: float
    lasted: float
    moved: Vector
    forces: Vector
    status: NDArray[np.int8]
    solves: int
    residual: float
    overlap: float
    lack: float = 0.0

    def in_state(self) -> tuple[Any, ...]:
        """Return what goes into the state."""
        return self[:-2]

    def fields(self) -> dict[str, Any]:
        """Return what goes into the state, by name."""
        return dict(zip(self._fields, self.in_state(), strict=False))
