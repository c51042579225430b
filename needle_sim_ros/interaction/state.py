# SPDX-License-Identifier: Apache-2.0
"""What the contact remembers from one step to the next; replaced, never changed in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.track import Track

_NONE = np.empty(0)

# part of a segment of the track after which its direction, and the next point, are found.
# The midpoint rule makes the path converge with the square of the spacing.
AIMED = 0.5
# advances, in track spacings, so small that the step in which the tip comes there will do;
# part of a step that is not worth a step of its own
_SMALL, _SLIVER = 0.05, 0.02


class ContactState(NamedTuple):
    """State of the contact after a step.

    Attributes
    ----------
    track : Track or None
        None before the first contact; a channel when the needle has left it.
    touching : bool
        The tip presses on the unbroken surface.
    inserted : bool
        The surface is broken and the tip below it.
    depth : float
        Position of the tip along the track, m.
    front : float
        Where the track ends: as far as the tip has cut, m.
    rate : float
        Advance of the tip along the track per advance of the base in the last step.
    heading : int
        Sign of the last advance of the base.
    bearing : float
        What the tip may bear, N: what cutting takes, and less and less of it in a hold.
    active : int
        Number of track points that carry forces, the one ahead of the tip included.
    lateral : ndarray, shape (d - 1, k)
        q_k of the k points that the tip has passed, N, on the tissue, along the base's
        lateral axes.
    friction : ndarray, shape (active,)
        f_k, N, on the tissue, along the base's axis.
    tip : float
        c, N, on the tissue, along the base's axis.
    arclength : ndarray, shape (k,)
        s_k where the lateral forces act, m from the clamp.
    softness : ndarray, shape (k,)
        Of the hold there, m/N.
    share : ndarray, shape (active,)
        How the tip force is spread over the track points; adds up to 1.
    strain : ndarray, shape (active,)
        Elastic presliding, m.
    slip : ndarray, shape (active,)
        What has not healed of the slip, m.
    slid : ndarray, shape (active,)
        Slip in the step, m.
    advance : float
        Of the base along the needle in the step, m.
    lasted : float
        Duration of the step, s.
    moved : ndarray, shape (n, d)
        Displacement of every track point, m.
    forces : ndarray, shape (n, d)
        Force on the tissue at every track point, tip included, mesh coordinates, N.
    status : ndarray of int8
        Bounds that hold, for the next step's warm start.
    solves : int
        Contact systems solved in the step.
    residual : float
        Largest violation of equilibrium in the step, relative to the largest gap.
    """

    track: Track | None = None
    touching: bool = False
    inserted: bool = False
    depth: float = 0.0
    front: float = 0.0
    rate: float = 0.0
    heading: int = 0
    bearing: float = 0.0
    active: int = 0
    lateral: Vector = np.empty((1, 0))
    friction: Vector = _NONE
    tip: float = 0.0
    arclength: Vector = _NONE
    softness: Vector = _NONE
    share: Vector = _NONE
    strain: Vector = _NONE
    slip: Vector = _NONE
    slid: Vector = _NONE
    advance: float = 0.0
    lasted: float = 0.0
    moved: Vector = np.empty((0, 2))
    forces: Vector = np.empty((0, 2))
    status: NDArray[np.int8] = np.empty(0, dtype=np.int8)
    solves: int = 0
    residual: float = 0.0

    def aiming(self, advance: float) -> float | None:
        """Return the part of an advance, m, after which the tip is where the track is aimed.

        None where it does not get there, or only small steps are taken anyway.
        """
        track = self.track
        if track is None or self.heading <= 0 or self.depth < self.front or self.rate <= 0:
            return None
        if advance < _SMALL * track.spacing:
            return None
        passed = self.depth / track.spacing - (track.laid - 2)
        share = (AIMED - passed) * track.spacing / (self.rate * advance)
        return max(share, _SLIVER) if 0.0 < share < 1.0 - _SLIVER else None
