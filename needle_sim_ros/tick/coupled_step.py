# SPDX-License-Identifier: Apache-2.0
"""One step of needle and tissue together: the tissue moves on once, the contact in parts."""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact import Contact
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.step import Step
from needle_sim_ros.scene import Scene
from needle_sim_ros.tick.division import Division, ends
from needle_sim_ros.tick.on_the_way import OnTheWay
from needle_sim_ros.tick.reach import Reach
from needle_sim_ros.tick.route import Route
from needle_sim_ros.tissue.dynamics import Dynamics, Prediction, WithinStep
from needle_sim_ros.tissue.response import Reading, ResponseTable


class Coupled(NamedTuple):
    """Needle and tissue at an instant."""

    contact: ContactState
    tissue: Any
    pose: BasePose


class _Plan(NamedTuple):
    """How a step is taken.

    Attributes
    ----------
    pieces : list of tuple of float
        Begin and end of each, as shares of the tick.
    fallen : float
        As in Step, at its end.
    onward : ndarray, shape (k, d)
        Forces at its end if they went on evenly, N.
    """

    pieces: list[tuple[float, float]]
    fallen: float
    onward: Vector


class _Followed(NamedTuple):
    """Contact and base after a step, how far that advanced, and in how many parts."""

    contact: ContactState
    pose: BasePose
    advance: float
    parts: int


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
    division : Division
    scene : Scene
    """

    def __init__(
        self,
        dynamics: Dynamics,
        laws: Contact,
        empty: ResponseTable,
        division: Division,
        scene: Scene,
    ) -> None:
        self._dynamics, self._laws, self._empty = dynamics, laws, empty
        self._division, self._reach = division, Reach.of(scene)
        self._length, self._viscosity = scene.needle.length, scene.tissue.damping.beta
        self._remembers = scene.solver.dynamics == "newmark"

    def carry_out(
        self,
        state: Coupled,
        route: Route,
        span: tuple[float, float],
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
        equal : int
            Parts that the contact takes at least; 0 where the tissue's step decides.
        settling : bool
            Whether the tissue's velocity jumps.

        Returns
        -------
        state : Coupled
        advance : float
            Of the base along the needle, m.
        parts : int
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
        far = swept = 0.0
        if self._remembers:
            whole = (2 if settling else 1) * (end - start)  # of a time step
            far, swept = whole * route.advance, whole * route.swept(self._length)
            self._reach.check(contact, far, swept)
            equal = self._division.of_step(contact, route, end - start, settling)
        followed = self._pressed(state, prediction, route, span, settling)
        if followed is None:
            plan = _Plan(_pieces(start, end, equal), 1.0, contact.forces)
            followed = self._followed(state, prediction, route, plan, settling)
        contact, pose, advance, parts = followed
        if self._remembers:
            self._reach.check(contact, far, swept)
        table = self._empty if contact.track is None else contact.track.table
        tissue = dynamics.complete(tissue, prediction, table, contact.forces)
        if not math.isfinite(np.add.reduce(contact.forces, axis=None) + contact.depth):
            raise SolverError("the tick gave numbers that are not finite")
        return Coupled(contact, tissue, pose), advance, parts

    def _pressed(
        self,
        state: Coupled,
        prediction: Prediction,
        route: Route,
        span: tuple[float, float],
        settling: bool,
    ) -> _Followed | None:
        """Follow a tip that presses on the surface through a step of the tissue.

        Up to where the surface breaks: how the tissue is dented there decides where the track
        leads; how finely time is divided must not. As the tissue takes forces to change evenly
        over all of the step, the tip's must not fall as far by its end as if it had fallen as
        long. None where there is no such tip.
        """
        if not (self._remembers and state.contact.touching):
            return None
        start, end = span
        lasts = (end - start) * route.duration
        step = Step(state.pose, route.at(end), lasts, prediction.rows, _unread)
        pressed = self._laws.pressed(state.contact, step)
        if pressed is None:
            return None
        if isinstance(pressed, ContactState):
            return _Followed(pressed, step.after, step.advance, 1)
        breaks = start + pressed.share * (end - start)
        rest = _pieces(breaks, end, self._division.of_opening(route, end - breaks))
        plan = _Plan([(start, breaks), *rest], 1.0 - pressed.share, pressed.onward)
        return self._followed(state, prediction, route, plan, settling)

    def _followed(
        self,
        state: Coupled,
        prediction: Prediction,
        route: Route,
        plan: _Plan,
        settling: bool,
    ) -> _Followed:
        """Follow the contact through the pieces of a step."""
        contact, tissue, pose = state
        pieces, fallen, onward = plan
        start, end = pieces[0][0], pieces[-1][1]
        within, way, advance, count, done = WithinStep(tissue, prediction), None, 0.0, 0, start
        for begin, to in pieces:
            for part in ends(contact, (to - begin) * route.length):
                share = to if part == 1.0 else begin + part * (to - begin)
                after, lasts = route.at(share), route.duration * (share - done)
                if share == end or not self._remembers:
                    at = partial(self._dynamics.at, within)
                    step = Step(pose, after, lasts, prediction.rows, at, fallen=fallen)
                    contact = self._laws.step(contact, step)
                else:
                    if way is None:
                        way = OnTheWay(
                            prediction.rows,
                            contact,
                            self._viscosity,
                            (end - start) * route.duration,
                            onward,
                            settling,
                        )
                    passed = (share - start) / (end - start)
                    yielded, rows = way.at(passed)
                    at = partial(self._dynamics.at, within._replace(yielded=yielded))
                    step = Step(pose, after, lasts, rows, at, yielded.part)
                    contact = self._laws.step(contact, step)
                    way.took(passed, contact)
                advance += step.advance
                pose, done, count = after, share, count + 1
        return _Followed(contact, pose, advance, count)


def _pieces(start: float, end: float, count: int) -> list[tuple[float, float]]:
    """Divide a part of a tick into equal pieces."""
    if count == 1:
        return [(start, end)]
    size = (end - start) / count
    cuts = [*(start + size * number for number in range(count)), end]
    return list(itertools.pairwise(cuts))


def _unread(table: ResponseTable, forces: Vector, reading: Reading) -> Vector:
    raise AssertionError("nothing is laid before the surface breaks")
