# SPDX-License-Identifier: Apache-2.0
"""A step of the contact, as its laws see it."""

from __future__ import annotations

from collections.abc import Callable

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.tissue.response import Reading, ResponseTable

FreeRows = Callable[[ResponseTable], Vector]
Sampler = Callable[[ResponseTable, Vector, Reading], Vector]


class Step:
    """What the base does in a step, and what the tissue would do by itself.

    Attributes
    ----------
    before, after : BasePose
    duration : float
        s.
    free : callable
        Displacement of the rows of a table at the end of the step without contact
        forces, (n, d).
    sample : callable
        Displacement (d,) of a footprint, by its reading, under forces on the rows of a table.
    yielding : float
        Part of the compliance of the rows that forces at the end of the step meet.
    fallen : float
        Part of its fall since the surface broke, that counts of what the tip bears.
    advance : float
        How far the base moves along the needle, m.
    turning : bool
        Whether the base turns.
    """

    __slots__ = (
        "advance",
        "after",
        "before",
        "duration",
        "fallen",
        "free",
        "sample",
        "turning",
        "yielding",
    )

    def __init__(
        self,
        before: BasePose,
        after: BasePose,
        duration: float,
        free: FreeRows,
        sample: Sampler,
        yielding: float = 1.0,
        fallen: float = 1.0,
    ) -> None:
        self.yielding, self.fallen = yielding, fallen
        self.before, self.after, self.duration = before, after, duration
        self.free, self.sample = free, sample
        self.advance = -after.ahead(before)
        self.turning = after.terms is not before.terms
