# SPDX-License-Identifier: Apache-2.0
"""The parameters that can be identified: what they are called, where they stand, their size."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.scene import Scene

Values = Mapping[str, float]


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes
    ----------
    name : str
        As given to ``--parameters``.
    unit : str
    key : str
        Dotted key in the scene; empty when it is none of the scene.
    size : float or None
        What counts as a large change; None: the value itself, which is positive.
    low, high : float
        Bounds; of positive ones as multiples of the start.
    """

    name: str
    unit: str
    key: str = ""
    size: float | None = None
    low: float = 1e-3
    high: float = 1e3

    @property
    def positive(self) -> bool:
        """Whether it is a positive quantity, of which relative changes count."""
        return self.size is None


_ALL = (
    Parameter("youngs_modulus", "Pa", "tissue.youngs_modulus"),
    Parameter("friction.static", "N/m", "interaction.friction.static"),
    Parameter("friction.kinetic", "N/m", "interaction.friction.kinetic"),
    Parameter("friction.weakening_distance", "m", "interaction.friction.weakening_distance"),
    Parameter("cutting.force", "N", "interaction.cutting.force"),
    Parameter("cutting.relaxation_time", "s", "interaction.cutting.relaxation_time"),
    Parameter("puncture.force", "N", "interaction.puncture.force"),
    Parameter("needle.youngs_modulus", "Pa", "needle.youngs_modulus"),
    Parameter("tip.deviation_angle", "rad", "needle.tip.deviation_angle", 0.05, -0.5, 0.5),
    Parameter("tip.roll", "rad", "needle.tip.roll", 0.2, -7.0, 7.0),
    *(Parameter(f"base_offset.{axis}", "m", "", 1e-3, -0.02, 0.02) for axis in "xyz"),
    *(Parameter(f"force_bias.{axis}", "N", "", 0.1, -10.0, 10.0) for axis in "xyz"),
)
PARAMETERS = {parameter.name: parameter for parameter in _ALL}
# the first of a pair is never above the second
ORDERED = (("friction.kinetic", "friction.static"), ("cutting.force", "puncture.force"))
DEFAULT = ("youngs_modulus", "friction.static", "friction.kinetic", "cutting.force")


def chosen(names: Sequence[str]) -> list[Parameter]:
    """Return parameters by name.

    Raises
    ------
    NeedleSimError
        On a name that there is not, or one given twice.
    """
    found = []
    for name in names:
        if name not in PARAMETERS:
            near = difflib.get_close_matches(name, PARAMETERS, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise NeedleSimError(
                f"parameter {name!r}: can be identified: {', '.join(PARAMETERS)}{hint}"
            )
        found.append(PARAMETERS[name])
    if len(set(names)) != len(names) or not names:
        raise NeedleSimError(f"parameters {', '.join(names) or '(none)'}: name each once")
    return found


def values_in(scene: Scene, parameters: Sequence[Parameter]) -> dict[str, float]:
    """Return the values that a scene has; zero for what is none of the scene."""
    values = {}
    for parameter in parameters:
        value: Any = scene
        for part in parameter.key.split(".") if parameter.key else ():
            value = getattr(value, part)
        values[parameter.name] = float(value) if parameter.key else 0.0
    return values


def with_values(scene: Scene, values: Values) -> Scene:
    """Return a scene with values; static friction and puncture stay above kinetic and cutting.

    ``base_offset`` moves the base at the start; ``force_bias`` changes no scene. Regions
    with a modulus of their own keep their ratio to the tissue's.
    """
    changes: dict[str, Any] = {
        PARAMETERS[name].key: value for name, value in values.items() if PARAMETERS[name].key
    }
    offset = offset_of(values)
    if any(offset):
        place = scene.base.position or (0.0, 0.0, 0.0)
        changes["base.position"] = [p + o for p, o in zip(place, offset, strict=True)]
    stiffer = values.get("youngs_modulus", scene.tissue.youngs_modulus)
    stiffer /= scene.tissue.youngs_modulus
    for index, region in enumerate(scene.tissue.regions):
        if region.youngs_modulus is not None and stiffer != 1.0:
            key = f"tissue.regions.{index}.youngs_modulus"
            changes[key] = region.youngs_modulus * stiffer
    laws = scene.interaction
    known = (
        (laws.friction.kinetic, laws.friction.static),
        (laws.cutting.force, laws.puncture.force or 0.0),
    )
    for (low, high), (least, most) in zip(ORDERED, known, strict=True):
        lower = values.get(low, least)
        if values.get(high, most) < lower:
            changes[f"interaction.{high}"] = lower
    return scene.with_changes(changes)


def offset_of(values: Values) -> tuple[float, float, float]:
    """Return the offset of the base, tissue frame, m."""
    return _vector(values, "base_offset")


def bias_of(values: Values) -> tuple[float, float, float]:
    """Return what the force sensor shows without force, base frame, N."""
    return _vector(values, "force_bias")


def _vector(values: Values, name: str) -> tuple[float, float, float]:
    x, y, z = (float(values.get(f"{name}.{axis}", 0.0)) for axis in "xyz")
    return x, y, z
