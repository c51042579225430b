# SPDX-License-Identifier: Apache-2.0
"""The cells of the stability benchmark: small scenes, and what the base does in them.

Every axis runs through its levels in shuffled rounds of its own, so that any run of cells,
the quick one included, meets all levels of all axes evenly and their pairs by chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needle_sim_ros.benchmark.stability_motions import (
    FASTEST,
    GAP,
    MOST_TICKS,
    MOTIONS,
    SIZE,
    Move,
    Setting,
)

THICKNESS = 0.024
LENGTH = 0.080

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
    "presliding": (3e6, 3e7),
    "deviation": (0.0, 0.05, -0.3),
    "ripple": (0.0, 0.0, 0.3),
    "dynamics": (0, 1, 2),
}
DYNAMICS = ("quasi_static", "newmark", "reduced")
_MODES = 20


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
    def dimension(self) -> int:
        """Of its scene."""
        return int(self.scene["dimension"])

    @property
    def dynamics(self) -> str:
        """How the tissue moves: quasi_static, newmark or reduced."""
        return DYNAMICS[int(self.level["dynamics"])]


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
    depth = min(float(draw.uniform(0.008, 0.02)), FASTEST * step * MOST_TICKS)
    along = 2 * level["track_spacing"]
    across = along / level["aspect"]
    setting = Setting(
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


def _scene(number: int, level: dict[str, float], setting: Setting) -> dict[str, Any]:
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
            "track_spacing": setting.spacing,
        },
        "base": {
            "position": [setting.entry - above * x, 0.0, above * -z],
            "orientation": [math.cos(half), 0.0, math.sin(half), 0.0],
        },
        "protocol": protocol,
    }
