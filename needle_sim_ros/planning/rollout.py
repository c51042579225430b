# SPDX-License-Identifier: Apache-2.0
"""Rollouts of insertions: to a travel, or until the tip arrives at a moving target."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.observation import Observation
from needle_sim_ros.planning.quick import MaterialPoint, QuickSimulator

# how near in depth, m, the tip has to come to the target's level, and in how many steps
_ARRIVED, _MOST_CORRECTIONS = 2e-6, 6
# what the needle may not do: how much of it stays outside, m
_SPARE = 1e-3


@dataclass(frozen=True)
class Outcome:
    """Where an insertion ends and what it took.

    Attributes
    ----------
    travel : float
        Of the base at the end, m.
    tip : ndarray, shape (3,)
        m.
    target : ndarray, shape (3,)
        Where the target has moved to, m; nan without one.
    peak_force : float
        Largest magnitude of the base force, N.
    deflection : float
        Largest deflection of the tip from the undeflected needle, m.
    track : ndarray, shape (k, 3)
        Reference positions of the track, m.
    steps : int
    stopped : str
        Why it ended before its end; empty if it did not.
    """

    travel: float
    tip: Vector
    target: Vector
    peak_force: float
    deflection: float
    track: Vector
    steps: int
    stopped: str = ""

    @property
    def gap(self) -> Vector:
        """From target to tip, (3,), m."""
        return np.asarray(self.tip - self.target)

    @property
    def miss(self) -> float:
        """Distance of tip and displaced target, m."""
        return float(np.linalg.norm(self.gap))


class Motion(Protocol):
    """A way of the base, by how far it has gone along the needle.

    ``turn`` is made in a stop at the travel ``turn_at``, within ``turn_time``.
    """

    @property
    def length(self) -> float:
        """Of the needle, m."""
        ...

    @property
    def speed(self) -> float:
        """Of the base along the needle, m/s."""
        ...

    @property
    def axis(self) -> Vector:
        """Unit vector along the needle, (3,)."""
        ...

    @property
    def travel(self) -> float:
        """Where it ends, m."""
        ...

    @property
    def turn(self) -> float:
        """Rad."""
        ...

    @property
    def turn_at(self) -> float:
        """M."""
        ...

    @property
    def turn_time(self) -> float:
        """S."""
        ...

    def command(self, travel: float) -> BaseCommand:
        """Return the pose of the base at a travel."""
        ...


Watcher = Callable[[Observation], object]


def roll_out(
    simulator: QuickSimulator,
    insertion: Motion,
    target: MaterialPoint | None = None,
    arrive: bool = False,
    watch: Watcher | None = None,
) -> Outcome:
    """Make an insertion from the start of a simulator.

    Parameters
    ----------
    simulator : QuickSimulator
        Reset before.
    insertion : Motion
    target : MaterialPoint, optional
    arrive : bool
        End where the tip reaches the level of the displaced target along the needle
        instead of at ``insertion.travel``.
    watch : callable, optional
        Told every observation.
    """
    simulator.reset()
    march = _March(simulator, insertion, target, watch)
    march.start()
    return _led(march, simulator, insertion, arrive)


def roll_on(
    simulator: QuickSimulator,
    motion: Motion,
    target: MaterialPoint | None = None,
    arrive: bool = False,
    watch: Watcher | None = None,
) -> Outcome:
    """Go on from the state in which a simulator is; parameters as of :func:`roll_out`.

    An end that is behind already is reached by drawing the needle back.
    """
    march = _March(simulator, motion, target, watch)
    if arrive and march.level() <= 0:
        march.settle(march.level(), back=True)
        return march.outcome("")
    return _led(march, simulator, motion, arrive)


def _led(march: _March, simulator: QuickSimulator, insertion: Motion, arrive: bool) -> Outcome:
    end = insertion.travel if not arrive else insertion.length - simulator.inserted - _SPARE
    try:
        while march.travel < end - 1e-12:
            ahead = min(simulator.next_stop(), end - march.travel)
            ahead = march.before_turn(ahead)
            if arrive:
                left = march.level()
                if left <= ahead:
                    march.settle(left)
                    break
            march.go(ahead)
    except NeedleSimError as error:
        return march.outcome(str(error))
    return march.outcome("")


class _March:
    """A rollout on its way."""

    def __init__(
        self,
        simulator: QuickSimulator,
        insertion: Motion,
        target: MaterialPoint | None,
        watch: Watcher | None,
    ) -> None:
        self._simulator, self._insertion = simulator, insertion
        self._target, self._watch = target, watch
        self.travel, self.steps = 0.0, 0
        self._force = self._deflection = 0.0
        self._turned = insertion.turn == 0.0 or insertion.turn_at <= 0.0
        self._last = simulator.observe()

    def start(self) -> None:
        """Put the tip on the surface."""
        self._last = self._simulator.step(self._insertion.command(0.0), 1.0)

    def before_turn(self, ahead: float) -> float:
        """Shorten a step that would pass the place of the second turn; make the turn there."""
        left = self._insertion.turn_at - self.travel
        if self._turned or left > ahead:
            return ahead
        if left > 1e-9:
            return left
        self._turned = True
        past = self._insertion.command(self.travel + 1e-9)
        self._note(self._simulator.step(past, max(self._insertion.turn_time, 1e-6)))
        return self._simulator.next_stop()

    def go(self, ahead: float) -> None:
        """Take a step."""
        self.travel += ahead
        command = self._insertion.command(self.travel)
        self._note(self._simulator.step(command, max(abs(ahead), 1e-9) / self._insertion.speed))

    def _note(self, seen: Observation) -> None:
        self._last, self.steps = seen, self.steps + 1
        self._force = max(self._force, float(np.linalg.norm(seen.base_force)))
        self._deflection = max(self._deflection, math.hypot(*seen.tip_deflection))
        if self._watch is not None:
            self._watch(seen)

    def level(self) -> float:
        """Return how far the tip still is from the level of the target, along the needle, m."""
        assert self._target is not None
        away = self._simulator.position_of(self._target) - self._last.tip_position
        return float(away @ self._insertion.axis)

    def settle(self, left: float, back: bool = False) -> None:
        """End at the level of the target: it gives way a little with every step."""
        before, start = self._simulator.snapshot(), self.travel
        ahead = left
        for _ in range(_MOST_CORRECTIONS):
            self._simulator.restore(before)
            self.travel = start
            self.go(ahead)
            missing = self.level()
            if abs(missing) <= _ARRIVED or (ahead + missing <= 0 and not back):
                return
            ahead += missing

    def outcome(self, stopped: str) -> Outcome:
        """Return what came out."""
        nowhere = np.full(3, np.nan)
        target = nowhere if self._target is None else self._simulator.position_of(self._target)
        return Outcome(
            travel=self.travel,
            tip=self._last.tip_position,
            target=target,
            peak_force=self._force * self._simulator.force_scale,
            deflection=self._deflection,
            track=self._simulator.track_points,
            steps=self.steps,
            stopped=stopped,
        )
