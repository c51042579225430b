# SPDX-License-Identifier: Apache-2.0
"""One step of needle and tissue together: the tissue moves on once, the contact in parts."""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from needle_sim_ros.base_motion import half_spacings
from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact import Contact, FreeRows, Step
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.scene import Scene
from needle_sim_ros.substeps import FreeOnTheWay, Reach, Route, ends, parts_of_step
from needle_sim_ros.tissue.dynamics import Dynamics, WithinStep
from needle_sim_ros.tissue.response import Reading, ResponseTable


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
    scene : Scene
    """

    def __init__(
        self,
        dynamics: Dynamics,
        laws: Contact,
        empty: ResponseTable,
        scene: Scene,
    ) -> None:
        self._dynamics, self._laws, self._empty = dynamics, laws, empty
        self._scene, self._spacing = scene, scene.solver.track_spacing
        self._reach, self._length = Reach.of(scene), scene.needle.length
        self._remembers = scene.solver.dynamics == "newmark"

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
        far = way = 0.0
        if self._remembers:
            whole = (2 if settling else 1) * (end - start)  # of a time step
            far, way = whole * route.advance, whole * route.swept(self._length)
            self._reach.check(contact, far, way)
            law, part = self._laws.laws.interaction.friction, end - start
            equal = parts_of_step(self._scene, law, contact, route, part, dt, settling)
        within = WithinStep(tissue, prediction, 1.0, contact.forces)

        pieces = _pieces(start, end, equal)
        if self._remembers and contact.touching:
            pieces = self._breaking(contact, prediction.rows, route, pose, span) or pieces
        free, advance, count, done = None, 0.0, 0, start
        for begin, to in pieces:
            for part in ends(contact, (to - begin) * route.length):
                share = to if part == 1.0 else begin + part * (to - begin)
                after = route.at(share)
                rows: FreeRows = prediction.rows
                here = within
                if self._remembers and share != end:
                    free = free or FreeOnTheWay(rows, contact)
                    here = within._replace(share=(share - start) / (end - start))
                    rows = free.at(here.share)
                step = Step(pose, after, dt * (share - done), rows, partial(dynamics.at, here))
                contact = self._laws.step(contact, step)
                advance += step.advance
                pose, done, count = after, share, count + 1
        if self._remembers:
            self._reach.check(contact, far, way)
        table = self._empty if contact.track is None else contact.track.table
        tissue = dynamics.complete(tissue, prediction, table, contact.forces)
        if not math.isfinite(np.add.reduce(contact.forces, axis=None) + contact.depth):
            raise SolverError("the tick gave numbers that are not finite")
        return Coupled(contact, tissue, pose), advance, count

    def _breaking(
        self,
        contact: ContactState,
        rows: FreeRows,
        route: Route,
        pose: BasePose,
        span: tuple[float, float],
    ) -> list[tuple[float, float]] | None:
        """Return pieces of a step in which the surface breaks, the first up to there.

        How the tissue is dented there decides where the track leads; how finely time is
        divided must not.
        """
        start, end = span
        step = Step(pose, route.at(end), 0.0, rows, _unread)
        share = self._laws.breaking(contact, step)
        if share is None:
            return None
        breaks = start + share * (end - start)
        parts = half_spacings((end - breaks) * route.length, self._spacing)
        return [(start, breaks), *_pieces(breaks, end, parts)]


def _pieces(start: float, end: float, count: int) -> list[tuple[float, float]]:
    """Divide a part of a tick into equal pieces."""
    if count == 1:
        return [(start, end)]
    size = (end - start) / count
    cuts = [*(start + size * number for number in range(count)), end]
    return list(itertools.pairwise(cuts))


def _unread(table: ResponseTable, forces: Vector, reading: Reading) -> Vector:
    raise AssertionError("nothing is laid before the surface breaks")
