# SPDX-License-Identifier: Apache-2.0
"""Cells of the stability benchmark in 3D: small coarse blocks, and what only 3D has.

Rolled bevels, bases that turn about the needle's axis, and moves in both lateral directions.
"""

from __future__ import annotations

import math
from typing import Any

from needle_sim_ros.benchmark.stability_cells import DYNAMICS, Cell
from needle_sim_ros.benchmark.stability_motions import Move

_LENGTH, _GAP, _STEP = 0.080, 1e-4, 0.02
_DEPTH, _TICKS = 0.016, 60
_MODES = 12
_IN = Move(_TICKS, (0.0, 0.0, -(_DEPTH + _GAP) / (_TICKS * _STEP)))
_ON = Move(20, (0.0, 0.0, -1e-3 / (20 * _STEP)))
_DRILL = Move(20, _ON.velocity, spin=(0.0, 0.0, 2 * math.pi))
_HOLD = Move(20)


def _aside(x: float, y: float) -> Move:
    return Move(20, (x / (20 * _STEP), y / (20 * _STEP), 0.0))


def _along(way: float) -> Move:
    return Move(40, (0.0, 0.0, way / (40 * _STEP)))


def _turned(x: float, y: float, z: float) -> Move:
    whole = 20 * _STEP
    return Move(20, spin=(x / whole, y / whole, z / whole))


_MOTIONS: dict[str, tuple[Move, ...]] = {
    "rolled bevel": (_IN, _ON, _HOLD),
    "on after a hold": (_IN, _HOLD, _ON, _HOLD),
    "spin": (_IN, _DRILL, _turned(0, 0, math.pi), _turned(0, 0, -0.5 * math.pi), _HOLD),
    "lateral": (_IN, _aside(1e-3, 0), _aside(0, 1e-3), _aside(-2e-3, -1e-3), _HOLD, _ON),
    "reversals": (_IN, _along(4e-3), _along(-2e-3), _along(1e-3), _along(-4e-3), _HOLD),
    "tilt": (_IN, _turned(0.01, 0, 0), _turned(0, 0.01, 0), _turned(-0.02, 0, 0), _HOLD),
    "out and in": (_IN, _HOLD, _along(0.02), _along(-0.018), _HOLD),
}
# modulus, Poisson's ratio, needle's modulus, roll, deviation, friction per E x depth, dynamics
_LEVELS = (
    (15e3, 0.45, 2.1e11, 0.7, 0.10, 0.02, 0),
    (3e3, 0.49, 7.0e10, -2.0, 0.05, 0.01, 0),
    (1e5, 0.30, 2.1e09, 1.5, 0.20, 0.02, 0),
    (15e3, 0.48, 2.1e11, 3.0, 0.10, 0.01, 2),
    (15e3, 0.45, 7.0e10, 0.3, 0.10, 0.02, 1),
)


def cells_3d(quick: bool, first: int) -> list[Cell]:
    """Return the cells.

    Parameters
    ----------
    quick : bool
        One of each motion, at changing levels.
    first : int
        Number of the first of them.
    """
    made: list[Cell] = []
    for place, motion in enumerate(_MOTIONS):
        for index, level in enumerate(_LEVELS):
            if not quick or index == place % len(_LEVELS):
                made.append(_cell(first + len(made), motion, level))
    return made


def _cell(number: int, motion: str, level: tuple[float, ...]) -> Cell:
    modulus, ratio, needle, roll, deviation, friction, dynamics = level
    names = {
        "youngs_modulus": modulus,
        "poisson_ratio": ratio,
        "needle_modulus": needle,
        "roll": roll,
        "deviation": deviation,
        "friction": friction,
        "time_step": _STEP,
        "dynamics": dynamics,
    }
    scene = _scene(number, names)
    return Cell(number, f"3D {motion}", names, scene, _MOTIONS[motion])


def _scene(number: int, level: dict[str, float]) -> dict[str, Any]:
    stiffness = level["youngs_modulus"] * 0.024
    kinetic = level["friction"] * stiffness
    dynamics = DYNAMICS[int(level["dynamics"])]
    return {
        "name": f"cell-{number}",
        "dimension": 3,
        "tissue": {
            "size": [0.040, 0.036, 0.030],
            "youngs_modulus": level["youngs_modulus"],
            "poisson_ratio": level["poisson_ratio"],
            "damping": {"beta": 5e-3},
            "mesh": {"spacing_across": 4e-3, "spacing_along": 4e-3, "growth": 3.0},
        },
        "needle": {
            "length": _LENGTH,
            "radius": 1e-3,
            "youngs_modulus": level["needle_modulus"],
            "tip": {
                "bevel_angle": 0.5,
                "deviation_angle": level["deviation"],
                "roll": level["roll"],
            },
        },
        "interaction": {
            "friction": {
                "static": 1.1 * kinetic,
                "kinetic": kinetic,
                "presliding_stiffness": 3e6 * stiffness,
            },
            "cutting": {"force": 2e-4 * stiffness, "relaxation_time": 0.5},
            "puncture": {"force": 3e-4 * stiffness},
        },
        "markers": [[0.004, 0.002, -0.004], [-0.008, 0.004, -0.012]],
        "solver": {
            "dynamics": "quasi_static" if dynamics == "quasi_static" else "newmark",
            "modes": _MODES if dynamics == "reduced" else 0,
            "time_step": _STEP,
            "track_spacing": 4e-3,
        },
        "base": {"position": [0.0, 0.0, _LENGTH + _GAP]},
        "protocol": [{"duration": 1.0, "velocity": [0.0, 0.0, -_DEPTH]}],
    }
