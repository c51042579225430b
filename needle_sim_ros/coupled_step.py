# SPDX-License-Identifier: Apache-2.0
"""One step of needle and tissue together: the tissue moves on once, the contact in parts."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from needle_sim_ros.errors import SolverError
from needle_sim_ros.interaction.contact import Contact, FreeRows, Step
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.substeps import FreeOnTheWay, Route, check_way, ends, parts_of_step
from needle_sim_ros.tissue.dynamics import Dynamics, WithinStep
from needle_sim_ros.tissue.response import ResponseTable


class Coupled(NamedTuple):
    """Needle and tissue at an instant."""

    contact: ContactState
    tissue: Any
    pose: BasePose


class CoupledStep:
    """Carries out parts of a tick.

    Parameters
    ----------
    dynamics : Dynamics
        Of the tissue.
    laws : Contact
        Between needle and tissue.
    empty : ResponseTable
        What a needle that has no track acts on.
    spacing : float
        Of the track, m.
    remembers : bool
        Whether the tissue has inertia or damping.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        laws: Contact,
        empty: ResponseTable,
        spacing: float,
        remembers: bool,
    ) -> None:
        self._dynamics, self._laws, self._empty = dynamics, laws, empty
        self._spacing, self._remembers = spacing, remembers

    def carry_out(
        self,
        state: Coupled,
        route: Route,
        span: tuple[float, float],
        dt: float,
        equal: int,
        settling: bool,
    ) -> tuple[Coupled, float, int]:
        """Move the tissue on by a part of the tick, and the contact in as many as it takes.

        Parameters
        ----------
        state : Coupled
        route : Route
            Of the base in the tick.
        span : tuple of float
            Where the part begins and ends, as shares of the tick.
        dt : float
            Of the tick, s.
        equal : int
            Parts that the contact takes at least; 0 where the tissue's step decides.
        settling : bool
            Whether the tissue's velocity jumps.

        Returns
        -------
        state : Coupled
        advance : float
            Of the base along the needle, m.
        count : int
            How often the balance was found.

        Raises
        ------
        CommandError
            When the step takes the needle where the model ends.
        SolverError
            When it has no finite answer.
        """
        dynamics, (start, end) = self._dynamics, span
        contact, tissue, pose = state
        prediction = dynamics.predict(tissue, settling)
        far = 0.0
        if self._remembers:
            far = (end - start) * route.advance
            check_way(contact, far, self._spacing)
            equal = parts_of_step(contact, (end - start) * route.length, self._spacing)
        within = WithinStep(tissue, prediction, 1.0, contact.forces)

        free, advance, count = None, 0.0, 0
        done, size = start, (end - start) / equal
        for number in range(equal):
            for part in ends(contact, size * route.length):
                last = part == 1.0 and number + 1 == equal
                share = end if last else start + size * (number + part)
                after = route.at(share)
                rows: FreeRows = prediction.rows
                here = within
                if self._remembers and not last:
                    free = free or FreeOnTheWay(rows, contact)
                    here = within._replace(share=(share - start) / (end - start))
                    rows = free.at(here.share)
                step = Step(pose, after, dt * (share - done), rows, partial(dynamics.at, here))
                contact = self._laws.step(contact, step)
                advance += step.advance
                pose, done, count = after, share, count + 1
        if self._remembers:
            check_way(contact, far, self._spacing)
        table = self._empty if contact.track is None else contact.track.table
        tissue = dynamics.complete(tissue, prediction, table, contact.forces)
        if not math.isfinite(np.add.reduce(contact.forces, axis=None) + contact.depth):
            raise SolverError("the tick gave numbers that are not finite")
        return Coupled(contact, tissue, pose), advance, count
