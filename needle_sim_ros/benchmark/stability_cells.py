# SPDX-License-Identifier: Apache-2.0
"""The cells of the stability benchmark: small scenes, and what the base does in them.

Every axis runs through its levels in shuffled rounds of its own, so that any run of cells,
the quick one included, meets all levels of all axes evenly and their pairs by chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needle_sim_ros.command import BaseCommand

SIZE = (0.060, 0.040)
THICKNESS = 0.024
LENGTH = 0.080
# the tip starts so far above the surface, m
GAP = 1e-4

# Tissue modulus (Pa), its Poisson ratio, needle modulus (Pa) and radius (m), time step (s),
# speed of the base (m/s), length over width of the cells at the needle, track spacing (m).
# Forces are given per tissue stiffness, E x thickness in N/m: friction per length, cutting
# as the displacement that it makes (m), presliding stiffness.
AXES: dict[str, tuple[float, ...]] = {
    "youngs_modulus": (1e3, 3e3, 15e3, 1e5, 1e6),
    "poisson_ratio": (0.0, 0.3, 0.45, 0.49, 0.499, 0.4999),
    "needle_modulus": (1e9, 2.1e9, 1e10, 7e10, 2.1e11),
    "radius": (1e-4, 2.5e-4, 5e-4, 1e-3, 2e-3),
    "time_step": (1e-4, 1e-3, 1e-2, 1e-1, 1.0),
    "speed": (0.0, 1e-3, 5e-3, 2e-2, 0.1, 0.5),
    "aspect": (0.5, 2.0, 4.0, 10.0, 40.0),
    "track_spacing": (7e-4, 1e-3, 2e-3, 3e-3),
    "friction": (0.0, 0.01, 0.03, 0.06),
    "cutting": (0.0, 2e-4, 1e-3),
    "presliding": (3e4, 3e5),
    "deviation": (0.0, 0.05, -0.3),
    "ripple": (0.0, 0.0, 0.3),
    "dynamics": (0, 1, 2),
    "newmark_delta": (0.5, 0.7, 1.0),
}
DYNAMICS = ("quasi_static", "newmark", "reduced")
_MODES = 20
_MOST_TICKS = 120
_FEW_TICKS = 30
_FASTEST = 0.5


@dataclass(frozen=True)
class Move:
    """A twist held for a number of ticks of the cell's time step."""

    ticks: int
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turning: float = 0.0

    def command(self) -> BaseCommand:
        """Return the command of each tick."""
        return BaseCommand(velocity=self.velocity, angular_velocity=(0.0, self.turning, 0.0))


@dataclass(frozen=True)
class Cell:
    """A scene as nested mappings, and the moves of the base.

    Attributes
    ----------
    motion : str
        Name of the kind of motion.
    level : dict
        Level of each axis.
    scene : dict
        What ``Scene.from_dict`` takes; it may refuse it.
    moves : tuple of Move
    ends_in_hold : bool
        Whether the answer after the hold is compared over time steps and tolerances.
    """

    number: int
    motion: str
    level: dict[str, float]
    scene: dict[str, Any]
    moves: tuple[Move, ...]
    ends_in_hold: bool = field(default=False)

    @property
    def dynamics(self) -> str:
        """How the tissue moves: quasi_static, newmark or reduced."""
        return DYNAMICS[int(self.level["dynamics"])]


@dataclass
class _Setting:
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
        fast = max(self.speed, (self.depth + GAP) / (_MOST_TICKS * self.step))
        fast = min(fast, _FASTEST)
        ticks = max(1, min(_MOST_TICKS, round((self.depth + GAP) / (fast * self.step))))
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
        whole, most = 1.4 * self.depth, 2 * _MOST_TICKS
        fast = min(max(self.speed, whole / (_MOST_TICKS * self.step)), _FASTEST)
        ticks = max(1, min(most, round(whole / (fast * self.step))))
        fast = min(fast, whole / (ticks * self.step))
        x, z = self.axis()
        return Move(ticks, (-fast * x, 0.0, -fast * z))

    def hold(self) -> Move:
        return Move(_FEW_TICKS)


def _straight(s: _Setting, draw: np.random.Generator) -> list[Move]:
    return [*s.inward(), s.hold(), s.outward(), s.hold()]


def _reversals(s: _Setting, draw: np.random.Generator) -> list[Move]:
    strokes = [s.stroke(sign * part * s.depth) for part in (0.3, 0.1, 0.02) for sign in (-1, 1)]
    return [*s.inward(), *strokes, s.hold()]


def _hold(s: _Setting, draw: np.random.Generator) -> list[Move]:
    return [*s.inward(), s.hold()]


def _lateral(s: _Setting, draw: np.random.Generator) -> list[Move]:
    aside = 0.1 * s.depth
    return [*s.inward(), s.aside(aside), s.aside(-2 * aside), s.hold(), s.stroke(0.1 * s.depth)]


def _turning(s: _Setting, draw: np.random.Generator) -> list[Move]:
    duration = _FEW_TICKS * s.step
    turn = Move(_FEW_TICKS, turning=0.05 / duration)
    back = Move(_FEW_TICKS, turning=-0.1 / duration)
    return [*s.inward(), turn, back, s.hold(), s.stroke(-0.3 * s.depth)]


def _edge(s: _Setting, draw: np.random.Generator) -> list[Move]:
    """Straight down a line of elements of a uniform mesh, a cell long the track spacing."""
    s.uniform, s.across = True, 3e-3
    s.entry = 3e-3 * float(draw.integers(-5, 6))
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _vertices(s: _Setting, draw: np.random.Generator) -> list[Move]:
    """Along the diagonals of a uniform mesh of squares, through their corners."""
    s.uniform, s.across, s.along = True, 2.5e-3, 2.5e-3
    s.spacing = max(s.spacing, 1.25e-3)
    s.angle, s.entry = math.pi / 4, -10e-3
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _inclined(s: _Setting, draw: np.random.Generator) -> list[Move]:
    s.angle = float(draw.uniform(-0.6, 0.6))
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _beside_side(s: _Setting, draw: np.random.Generator) -> list[Move]:
    """Down beside a side, partly on it: the cross-section counts as far as it is inside."""
    s.uniform, s.across = True, 3e-3
    s.entry = -SIZE[0] / 2 + float(draw.choice([0.0, 5e-5, 1e-3]))
    return [*s.inward(), s.hold(), s.stroke(-0.3 * s.depth)]


def _out_of_side(s: _Setting, draw: np.random.Generator) -> list[Move]:
    """Inclined through a side, or the lower corner: to be refused where the tissue ends."""
    s.uniform, s.across = True, 3e-3
    s.angle, s.entry = float(draw.uniform(0.3, 0.8)), 0.35 * SIZE[0]
    return [*s.inward(), s.stroke(0.03, speed=_FASTEST), s.hold()]


def _overrun(s: _Setting, draw: np.random.Generator) -> list[Move]:
    """A stage that does what it was told for a tick, however far that is."""
    x, z = s.axis()
    return [*s.inward(), Move(1, (s.speed * x, 0.0, s.speed * z)), s.hold()]


def _again(s: _Setting, draw: np.random.Generator) -> list[Move]:
    """Out and into the old channel again, and then beside it."""
    first = s.inward()
    beside = Move(1, (4e-3 / s.step, 0.0, 0.0))
    return [*first, s.outward(), *first, s.outward(), beside, first[0], s.hold()]


MOTIONS: dict[str, Callable[[_Setting, np.random.Generator], list[Move]]] = {
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


def cells(count: int, seed: int = 3) -> list[Cell]:
    """Return the first cells of the design; they are the same for every count and machine.

    Parameters
    ----------
    count : int
    seed : int
        Another design of the same kind.
    """
    levels = {
        name: _rounds(values, count, np.random.default_rng([seed, index]))
        for index, (name, values) in enumerate(AXES.items())
    }
    names = _rounds(tuple(range(len(MOTIONS))), count, np.random.default_rng([seed, 99]))
    motions = list(MOTIONS)
    return [
        _cell(number, motions[int(names[number])], {k: v[number] for k, v in levels.items()}, seed)
        for number in range(count)
    ]


def _rounds(values: tuple[float, ...], count: int, draw: np.random.Generator) -> list[float]:
    taken: list[float] = []
    while len(taken) < count:
        taken += [values[int(i)] for i in draw.permutation(len(values))]
    return taken[:count]


def _cell(number: int, motion: str, level: dict[str, float], seed: int) -> Cell:
    draw = np.random.default_rng([seed, 1000, number])
    step = level["time_step"]
    # what the fastest stage reaches in the ticks of a stroke
    depth = min(float(draw.uniform(0.008, 0.02)), _FASTEST * step * _MOST_TICKS)
    along = 2 * level["track_spacing"]
    across = along / level["aspect"]
    setting = _Setting(
        depth,
        level["speed"],
        step,
        across=across,
        along=along,
        spacing=level["track_spacing"],
    )
    moves = MOTIONS[motion](setting, draw)
    return Cell(
        number, motion, level, _scene(number, level, setting), tuple(moves), motion == "hold"
    )


def _scene(number: int, level: dict[str, float], setting: _Setting) -> dict[str, Any]:
    stiffness = level["youngs_modulus"] * THICKNESS
    kinetic, cutting = level["friction"] * stiffness, level["cutting"] * stiffness
    dynamics = DYNAMICS[int(level["dynamics"])]
    x, z = setting.axis()
    above = LENGTH + GAP / -z
    protocol = [
        {
            "duration": 1.0,
            "velocity": [setting.depth * x, 0.0, setting.depth * z],
        }
    ]
    # base z along the needle: pi about x points it down, then the inclination about y
    half = 0.5 * setting.angle
    return {
        "name": f"cell-{number}",
        "dimension": 2,
        "tissue": {
            "size": list(SIZE),
            "thickness": THICKNESS,
            "youngs_modulus": level["youngs_modulus"],
            "poisson_ratio": level["poisson_ratio"],
            "damping": {"beta": 5e-3},
            "mesh": {
                "spacing_across": setting.across,
                "spacing_along": setting.along,
                "growth": 2.5,
                "band": max(setting.across, level["radius"]),
                "uniform": setting.uniform,
            },
        },
        "needle": {
            "length": LENGTH,
            "radius": level["radius"],
            "youngs_modulus": level["needle_modulus"],
            "tip": {"bevel_angle": 0.5, "deviation_angle": level["deviation"]},
        },
        "interaction": {
            "friction": {
                "static": 1.1 * kinetic,
                "kinetic": kinetic,
                "presliding_stiffness": level["presliding"] * stiffness,
            },
            "cutting": {
                "force": cutting,
                "relaxation_time": 0.5,
                # long enough for the tissue to follow: a steeper ripple snaps from tooth to tooth
                "ripple": {
                    "amplitude": level["ripple"],
                    "wavelength": 2e-3 + 8 * level["cutting"],
                },
            },
            "puncture": {"force": 1.5 * cutting},
        },
        "markers": [[0.004, 0.0, -0.004], [-0.008, 0.0, -0.012], [0.003, 0.0, -0.030]],
        "solver": {
            "dynamics": "quasi_static" if dynamics == "quasi_static" else "newmark",
            "modes": _MODES if dynamics == "reduced" else 0,
            "time_step": level["time_step"],
            "newmark": {
                "delta": level["newmark_delta"],
                "xi": 0.25 * (0.5 + level["newmark_delta"]) ** 2,
            },
            "track_spacing": setting.spacing,
        },
        "base": {
            "position": [setting.entry - above * x, 0.0, above * -z],
            "orientation": [math.cos(half), 0.0, math.sin(half), 0.0],
        },
        "protocol": protocol,
    }
