# SPDX-License-Identifier: Apache-2.0
"""The parameters `interaction.*`: friction, cutting and puncture, live, with ranges."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.parameter import Parameter

from needle_sim_ros.errors import SceneError
from needle_sim_ros.ros.plant import changed_scene
from needle_sim_ros.scene import Interaction, Scene

PREFIX = "interaction."
_SMALLEST, _GREATEST = 1e-12, 1e12  # where the scene's own bound is open or missing


def described(scene: Scene) -> Iterator[tuple[str, float, ParameterDescriptor]]:
    """Yield name, value in the scene, and descriptor of every parameter."""
    for key, value in _leaves(scene.to_dict()["interaction"]):
        bounds = _metadata(key)
        low = bounds["ge"] if bounds["ge"] is not None else _SMALLEST
        high = bounds["le"] if bounds["le"] is not None else max(_GREATEST, value)
        unit = "" if bounds["unit"] == "1" else f", {bounds['unit']}"
        descriptor = ParameterDescriptor(
            description=f"Scene key {PREFIX}{key}{unit}; the default is the scene's.",
            additional_constraints="Live: holds from the next tick. Static friction is at least"
            " the kinetic one, the puncture force at least the cutting force: set both at once.",
            floating_point_range=[FloatingPointRange(from_value=float(low), to_value=float(high))],
        )
        yield PREFIX + key, value, descriptor


def changes_in(scene: Scene, parameters: Iterable[Parameter]) -> dict[str, float]:
    """Return what of set parameters differs from a scene, by keys below `interaction`."""
    now = dict(_leaves(scene.to_dict()["interaction"]))
    return {
        parameter.name[len(PREFIX) :]: float(parameter.value)
        for parameter in parameters
        if parameter.name.startswith(PREFIX)
        and parameter.name[len(PREFIX) :] in now
        and now[parameter.name[len(PREFIX) :]] != parameter.value
    }


def refusal(scene: Scene, parameters: Iterable[Parameter]) -> str | None:
    """Return why a scene cannot take set parameters, or None when it can."""
    changes = changes_in(scene, parameters)
    if changes:
        try:
            changed_scene(scene, changes)
        except SceneError as error:
            return str(error)
    return None


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield prefix + name, float(value)


def _metadata(key: str) -> Mapping[str, Any]:
    """Return unit and bounds of a dotted key, as the scene's schema declares them."""
    kind: Any = Interaction
    *path, last = key.split(".")
    for name in path:
        kind = typing.get_type_hints(kind)[name]
    return {field.name: field.metadata for field in dataclasses.fields(kind)}[last]
