# SPDX-License-Identifier: Apache-2.0
"""Uncertain parameters: read from a file, such as `identify` writes, and sampled."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.scene import Scene

# short names, as `identify` uses them, by what they stand below in a scene
_PLACES = {
    "youngs_modulus": "tissue.youngs_modulus",
    "friction": "interaction.friction",
    "cutting": "interaction.cutting",
    "puncture": "interaction.puncture",
    "tip": "needle.tip",
}
# what may have either sign
_SIGNED = ("needle.tip.deviation_angle", "needle.tip.roll")
# the left may not be below the right: a sample that is takes the left along
_ORDERED = (
    ("interaction.friction.static", "interaction.friction.kinetic"),
    ("interaction.puncture.force", "interaction.cutting.force"),
)
_MOST_DRAWS = 1000


@dataclass(frozen=True)
class Uncertainty:
    """Parameters of a scene with standard errors.

    Attributes
    ----------
    parameters : dict
        Dotted key of the scene to (value, standard error).
    """

    parameters: dict[str, tuple[float, float]]

    @classmethod
    def load(cls, path: Path, scene: Scene) -> Uncertainty:
        """Read ``{"parameters": {name: {"value": v, "standard_error": s}}}``.

        Raises
        ------
        NeedleSimError
            When the file is not that, or names what the scene has not.
        """
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise NeedleSimError(f"{path}: cannot be read: {error}") from None
        except ValueError as error:
            raise NeedleSimError(f"{path}: not JSON: {error}") from None
        given = data.get("parameters") if isinstance(data, dict) else None
        if not isinstance(given, Mapping) or not given:
            raise NeedleSimError(
                f'{path}: must be {{"parameters": {{name: {{"value": …, "standard_error": …}}}}}}'
            )
        found = cls({_key(name): _pair(path, name, entry) for name, entry in given.items()})
        scene.with_changes({key: value for key, (value, _) in found.parameters.items()})
        return found

    def draw(self, scene: Scene, seed: int, number: int) -> dict[str, float]:
        """Return the values of one sample; the same for the same seed and number.

        Normal, cut off at zero for what cannot be negative.
        """
        generator = np.random.default_rng([seed, number])
        values: dict[str, float] = {}
        for key, (value, error) in sorted(self.parameters.items()):
            values[key] = _drawn(generator, key, value, error)
        for upper, lower in _ORDERED:
            own = values.get(upper, _value(scene, upper))
            values_lower = values.get(lower, _value(scene, lower))
            if (upper in values or lower in values) and own < values_lower:
                values[upper] = values_lower
        return values


def _drawn(generator: np.random.Generator, key: str, value: float, error: float) -> float:
    for _ in range(_MOST_DRAWS):
        drawn = float(generator.normal(value, error))
        if drawn > 0 or key in _SIGNED:
            return drawn
    return value


def _key(name: str) -> str:
    head, _, rest = name.partition(".")
    if name in _PLACES:
        return _PLACES[name]
    return f"{_PLACES[head]}.{rest}" if head in _PLACES and rest else name


def _pair(path: Path, name: str, entry: object) -> tuple[float, float]:
    if isinstance(entry, Mapping):
        value, error = entry.get("value"), entry.get("standard_error")
        numbers = all(
            isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x)
            for x in (value, error)
        )
        if numbers and error >= 0:  # type: ignore[operator]
            return float(value), float(error)  # type: ignore[arg-type]
    raise NeedleSimError(f"{path}: {name} = {entry!r}: must have a value and a standard_error >= 0")


def _value(scene: Scene, key: str) -> float:
    found: object = scene
    for part in key.split("."):
        found = getattr(found, part)
    assert isinstance(found, (int, float))
    return float(found)
