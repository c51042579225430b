# SPDX-License-Identifier: Apache-2.0
"""What a planner may vary, as a vector whose unit moves the tip by about a millimetre."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.scene import Scene

# of a unit, for differences; more where the bevel turns, whose effect is rough
_STEP, _BEVEL_STEP = 0.1, 0.4
_OF_BEVEL = ("roll", "turn", "turn_at")
_MOST_OFFSET = 10e-3  # m
_STEEPEST = math.radians(25)


@dataclass(frozen=True)
class _Variable:
    """One number: how it is set, its unit, its bounds in units, where else to start."""

    name: str
    component: int
    unit: float
    low: float
    high: float
    starts: tuple[float, ...] = ()


class Variables:
    """The numbers that vary.

    Parameters
    ----------
    variables : list of _Variable
    """

    def __init__(self, variables: list[_Variable]) -> None:
        self._variables = variables

    @classmethod
    def of(cls, vary: tuple[str, ...], scene: Scene, aim: Insertion, reach: float) -> Variables:
        """Return the variables of some names about an aim."""
        components = range(scene.dimension - 1)
        depth = aim.travel
        found: list[_Variable] = []
        for name in vary:
            if name == "entry":
                room = [size / 2 - 2 * scene.needle.radius for size in scene.tissue.size]
                for i in components:
                    low = max(-reach, -room[i] - aim.entry[i])
                    high = min(reach, room[i] - aim.entry[i])
                    found.append(_Variable(name, i, 1e-3, low / 1e-3, high / 1e-3))
            elif name == "inclination":
                unit = 1e-3 / depth
                found += [
                    _Variable(name, i, unit, -_STEEPEST / unit, _STEEPEST / unit)
                    for i in components
                ]
            elif name == "offset":
                most = _MOST_OFFSET / 1e-3
                found += [_Variable(name, i, 1e-3, -most, most) for i in components]
            elif name == "roll":
                quarters = tuple(k * math.pi / 2 / 0.2 for k in (1, 2, -1))
                found.append(_Variable(name, 0, 0.2, -60.0, 60.0, quarters))
            else:
                found.append(_Variable("turn", 0, 0.2, -40.0, 40.0, (15.0, -15.0)))
                unit = 1e-3 * 5
                low, high = -0.4 * depth / unit, 0.4 * depth / unit
                found.append(_Variable("turn_at", 0, unit, low, high))
        return cls(found)

    def bounds(self) -> tuple[Vector, Vector]:
        """Return lower and upper bounds, shapes (n,)."""
        low = np.array([v.low for v in self._variables])
        return low, np.array([v.high for v in self._variables])

    def steps(self) -> Vector:
        """Return steps for differences, shape (n,)."""
        return np.array([_BEVEL_STEP if v.name in _OF_BEVEL else _STEP for v in self._variables])

    def starts(self, guess: dict[str, float]) -> Iterator[Vector]:
        """Yield where to start from: a guess of roll and turn, the plain aim, turned bevels.

        Parameters
        ----------
        guess : dict
            Values of some of the variables by name, in their own units.
        """
        known = [guess.get(v.name, 0.0) / v.unit for v in self._variables]
        yield np.array(known)
        choices = [(0.0, *v.starts) for v in self._variables]
        for choice in itertools.product(*choices):
            if any(choice) or any(known):
                yield np.array(choice)

    def apply(self, aim: Insertion, x: Vector) -> Insertion:
        """Return the aim with the variables added to it."""
        changes: dict[str, list[float]] = {}
        for variable, value in zip(self._variables, x.tolist(), strict=True):
            if variable.name in ("entry", "inclination", "offset"):
                pair = changes.setdefault(variable.name, list(getattr(aim, variable.name)))
                pair[variable.component] += value * variable.unit
        single = {
            v.name: getattr(aim, v.name) + value * v.unit
            for v, value in zip(self._variables, x.tolist(), strict=True)
            if v.name in _OF_BEVEL
        }
        pairs = {name: (pair[0], pair[1]) for name, pair in changes.items()}
        return replace(aim, **pairs, **single)  # type: ignore[arg-type]

    def of_insertion(self, aim: Insertion, insertion: Insertion) -> Vector:
        """Return the variables that make an insertion of an aim, the inverse of `apply`."""
        found = []
        for v in self._variables:
            here, there = getattr(aim, v.name), getattr(insertion, v.name)
            if v.name not in _OF_BEVEL:
                here, there = here[v.component], there[v.component]
            found.append((there - here) / v.unit)
        return np.array(found)
