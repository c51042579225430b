# SPDX-License-Identifier: Apache-2.0
"""What a balance of an inserted needle is about, whoever finds it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.friction import FrictionMemory
from needle_sim_ros.interaction.lateral_hold import LateralHold
from needle_sim_ros.interaction.step import Step
from needle_sim_ros.interaction.track import Track


class InsertedTask(NamedTuple):
    """A step of an inserted needle whose tip is at a depth of its track.

    Attributes
    ----------
    track : Track
    step : Step
    free, moved : ndarray, shape (laid, d)
        Displacement of the track points without forces, and before the step, m.
    memory : FrictionMemory
        Of the step before.
    status : ndarray of int8, shape (n + 1,)
        Guess of the bounds that hold: friction of each point, and last the tip.
    depth : float
        Of the tip, m.
    held : int
        Number of points that are held laterally.
    hold : LateralHold or None
        Of these, for a guess that leaves nothing free.
    reach : float
        How far the tip would be beyond its place on the undeformed track, m.
    limit : float
        Largest tip force, N.
    """

    track: Track
    step: Step
    free: Vector
    moved: Vector
    memory: FrictionMemory
    status: NDArray[np.int8]
    depth: float
    held: int
    hold: LateralHold | None
    reach: float
    limit: float
