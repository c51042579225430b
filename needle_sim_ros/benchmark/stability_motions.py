# SPDX-License-Identifier: Apache-2.0
"""What the base does in the cells of the stability benchmark."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.command import BaseCommand

# of the tissue, m
SIZE = (0.060, 0.040)
# the tip starts so far above the surface, m
GAP = 1e-4
MOST_TICKS = 120
FASTEST = 0.5
_FEW_TICKS = 30


@dataclass(frozen=True)
class Move:
    """A twist held for a number of ticks of the cell's time step."""

    ticks: int
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turning: float = 0.0
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def command(self) -> BaseCommand:
        """Return the command of each tick."""
        x, y, z = self.spin
        return BaseCommand(velocity=self.velocity, angular_velocity=(x, y + self.turning, z))


@dataclass
class Setting:
    """What a kind of motion starts from and may change."""

    depth: float
    speed: float
    step: float
    angle: float = 0.0
    entry: float = 0.0
    uniform: bool = False
    across: float = 1e-3
    along: float = 2e-3
    spacing: float = 1e-3

    def axis(self) -> tuple[float, float]:
        """Direction of the needle: x and z."""
        return math.sin(self.angle), -math.cos(self.angle)

    def stroke(self, length: float, speed: float | None = None) -> Move:
        """Go so far along the needle; slower where a tick would cover more."""
        fast = self.speed if speed is None else speed
        ticks = _FEW_TICKS
        if fast > 0:
            ticks = max(1, min(_FEW_TICKS, round(abs(length) / (fast * self.step))))
            fast = min(fast, abs(length) / (ticks * self.step))
        x, z = self.axis()
        signed = math.copysign(fast, length)
        return Move(ticks, (signed * x, 0.0, signed * z))

    def inward(self) -> list[Move]:
        """Reach the depth in few ticks, however slow the cell is, and then go at its speed."""
        fast = max(self.speed, (self.depth + GAP) / (MOST_TICKS * self.step))
        fast = min(fast, FASTEST)
        ticks = max(1, min(MOST_TICKS, round((self.depth + GAP) / (fast * self.step))))
        fast = min(fast, (self.depth + GAP) / (ticks * self.step))
        x, z = self.axis()
        return [Move(ticks, (fast * x, 0.0, fast * z)), self.stroke(self.depth / 6)]

    def aside(self, length: float) -> Move:
        """Move the base across the needle."""
        move = self.stroke(length)
        x, z = self.axis()
        along = move.velocity[0] * x + move.velocity[2] * z
        return Move(move.ticks, (-along * z, 0.0, along * x))

    def outward(self) -> Move:
        """Leave the tissue, at whatever speed it takes."""
        whole, most = 1.4 * self.depth, 2 * MOST_TICKS
        fast = min(max(self.speed, whole / (MOST_TICKS * self.step)), FASTEST)
        ticks = max(1, min(most, round(whole / (fast * self.step))))
        fast = min(fast, whole / (ticks * self.step))
        x, z = self.axis()
        return Move(ticks, (-fast * x, 0.0, -fast * z))

    def hold(self) -> Move:
        """Stand still."""
        return Move(_FEW_TICKS)


def _straight(s: Setting, draw: np.random.Generator) -> list[Move]:
    return [*s.inward(), s.hold(), s.outward(), s.hold()]


def _reversals(s: Setting, draw: np.random.Generator) -> list[Move]:
    strokes = [s.stroke(sign * part * s.depth) for part in (0.3, 0.1, 0.02) for sign in (-1, 1)]
    return [*s.inward(), *strokes, s.hold()]


def _hold(s: Setting, draw: np.random.Generator) -> list[Move]:
    return [*s.inward(), s.hold()]


def _lateral(s: Setting, draw: np.random.Generator) -> list[Move]:
    aside = 0.1 * s.depth
    return [*s.inward(), s.aside(aside), s.aside(-2 * aside), s.hold(), s.stroke(0.1 * s.depth)]


def _turning(s: Setting, draw: np.random.Generator) -> list[Move]:
    duration = _FEW_TICKS * s.step
    turn = Move(_FEW_TICKS, turning=0.05 / duration)
    back = Move(_FEW_TICKS, turning=-0.1 / duration)
    return [*s.inward(), turn, back, s.hold(), s.stroke(-0.3 * s.depth)]


def _edge(s: Setting, draw: np.random.Generator) -> list[Move]:
    """Straight down a line of elements of a uniform mesh, a cell long the track spacing."""
    s.uniform, s.across = True, 3e-3
    s.entry = 3e-3 * float(draw.integers(-5, 6))
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _vertices(s: Setting, draw: np.random.Generator) -> list[Move]:
    """Along the diagonals of a uniform mesh of squares, through their corners."""
    s.uniform, s.across, s.along = True, 2.5e-3, 2.5e-3
    s.spacing = max(s.spacing, 1.25e-3)
    s.angle, s.entry = math.pi / 4, -10e-3
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _inclined(s: Setting, draw: np.random.Generator) -> list[Move]:
    s.angle = float(draw.uniform(-0.6, 0.6))
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _beside_side(s: Setting, draw: np.random.Generator) -> list[Move]:
    """Down beside a side, partly on it: the cross-section counts as far as it is inside."""
    s.uniform, s.across = True, 3e-3
    s.entry = -SIZE[0] / 2 + float(draw.choice([0.0, 5e-5, 1e-3]))
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _out_of_side(s: Setting, draw: np.random.Generator) -> list[Move]:
    """Inclined through a side, or the lower corner: to be refused where the tissue ends."""
    s.uniform, s.across = True, 3e-3
    s.angle, s.entry = float(draw.uniform(0.3, 0.8)), 0.35 * SIZE[0]
    return [*s.inward(), s.stroke(0.03, speed=FASTEST), s.hold()]


def _overrun(s: Setting, draw: np.random.Generator) -> list[Move]:
    """A stage that does what it was told for a tick, however far that is."""
    x, z = s.axis()
    return [*s.inward(), Move(1, (s.speed * x, 0.0, s.speed * z)), s.hold()]


def _again(s: Setting, draw: np.random.Generator) -> list[Move]:
    """Out and into the old channel again, and then beside it."""
    first = s.inward()
    beside = Move(1, (4e-3 / s.step, 0.0, 0.0))
    return [*first, s.outward(), *first, s.outward(), beside, first[0], s.hold()]


MOTIONS: dict[str, Callable[[Setting, np.random.Generator], list[Move]]] = {
    "straight": _straight,
    "reversals": _reversals,
    "hold": _hold,
    "lateral": _lateral,
    "turning": _turning,
    "edge": _edge,
    "vertices": _vertices,
    "inclined": _inclined,
    "beside side": _beside_side,
    "out of side": _out_of_side,
    "overrun": _overrun,
    "again": _again,
}
