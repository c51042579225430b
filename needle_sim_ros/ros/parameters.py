# SPDX-License-Identifier: Apache-2.0
"""The node's parameters: described, ranged, and refused with a reason."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import yaml
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros import awake, interaction_parameters, own_core
from needle_sim_ros.ros.commands import StageLimits
from needle_sim_ros.ros.plant import Plant
from needle_sim_ros.ros.record_folder import RecordFolder
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.bag import Split
from needle_sim_ros.session.writer import BASE_FRAME, TISSUE_FRAME


class ParameterError(NeedleSimError):
    """A parameter that the node cannot start with."""


@dataclass(frozen=True)
class _Number:
    default: float
    lowest: float
    highest: float
    live: bool
    description: str


_NUMBERS = {
    "rate": _Number(100.0, 0.1, 10_000.0, False, "Ticks per second, Hz."),
    "command_timeout": _Number(
        0.5, 0.0, 3600.0, True, "A command holds for this simulated time, s; 0: until the next."
    ),
    "max_base_speed": _Number(0.1, 1e-6, 10.0, True, "Fastest motion of the base, m/s."),
    "max_base_angular_speed": _Number(1.0, 1e-6, 100.0, True, "Fastest turn of the base, rad/s."),
    "max_base_jump": _Number(
        0.5, 1e-6, 100.0, True, "Poses farther than this from the base are refused, m."
    ),
    "realtime_priority": _Number(
        0.0, 0.0, 99.0, False, "Priority of the clock loop (SCHED_FIFO, 1 to 99); 0: normal."
    ),
    "visualization_rate": _Number(
        20.0, 0.1, 20.0, True, "Pictures for viewers a second at most, Hz; only when subscribed."
    ),
    "record_split_size": _Number(
        0.0, 0.0, 1e15, True, "Sessions go on in another file at this size, bytes; 0: never."
    ),
    "record_split_duration": _Number(
        0.0, 0.0, 1e9, True, "Sessions go on in another file after this log time, s; 0: never."
    ),
}
_TEXTS = {
    "scene": ("gao2016", False, "Scene: a file, or the bare name of one that comes along."),
    "scene_overrides": ("", False, "Scene keys to change: KEY=VALUE; KEY=VALUE."),
    "record": (
        "",
        True,
        "Folder to record sessions in, inside record_root; empty at the start: do not record.",
    ),
    "record_root": (
        "",
        False,
        "Folder that recordings stay inside; empty: that of `record` at the start, or the"
        " working folder.",
    ),
    "tissue_frame": (TISSUE_FRAME, False, "Frame id of the tissue frame."),
    "base_frame": (BASE_FRAME, False, "Frame id of the needle base frame."),
}
_LIMITS = ("command_timeout", "max_base_speed", "max_base_angular_speed", "max_base_jump")


class Validated(Protocol):
    """What changes of parameters are checked against."""

    plant: Plant
    record_folder: RecordFolder


@dataclass(frozen=True)
class Settings:
    """What the node starts with."""

    scene: Scene
    rate: float
    limits: StageLimits
    realtime_priority: float
    dedicated_core: int
    keep_awake: bool
    publish_clock: bool
    record: bool
    record_folder: RecordFolder
    tissue_frame: str
    base_frame: str

    @property
    def period(self) -> float:
        """Dt of a tick, s."""
        return 1.0 / self.rate


def declare(node: Node) -> Settings:
    """Declare all parameters and return what they were set to.

    Raises
    ------
    ParameterError, SceneError
        Naming the parameter or key, the value and what is allowed.
    """
    texts = {name: _declare_text(node, name) for name in _TEXTS}
    numbers = {name: _declare_number(node, name, number) for name, number in _NUMBERS.items()}
    publish_clock = _declared(
        node,
        "publish_clock",
        False,
        ParameterDescriptor(
            description="Publish the simulated time on /clock: this node is the time source.",
            read_only=True,
        ),
    )
    if publish_clock and node.get_parameter("use_sim_time").value:
        raise ParameterError("publish_clock and use_sim_time are both true: choose one time source")
    core = _declare_core(node)
    keep_awake = _declare_awake(node, core)
    overrides = _overrides(texts["scene_overrides"])
    scene = Scene.load(texts["scene"], overrides)
    scene = _declare_interaction(node, scene)
    _check_rate(scene, numbers["rate"])
    return Settings(
        scene=scene,
        rate=numbers["rate"],
        limits=limits(numbers),
        realtime_priority=numbers["realtime_priority"],
        dedicated_core=core,
        keep_awake=keep_awake,
        publish_clock=bool(publish_clock),
        record=bool(texts["record"]),
        record_folder=RecordFolder(
            Path(texts["record_root"] or texts["record"] or "."),
            texts["record"],
            current_split(node),
        ),
        tissue_frame=texts["tissue_frame"],
        base_frame=texts["base_frame"],
    )


def current_record(node: Node) -> str:
    """Return the folder to record in as the parameter is now."""
    return str(node.get_parameter("record").value)


def current_split(node: Node) -> Split:
    """Return when sessions go on in another file, as the parameters are now."""
    names = ("record_split_size", "record_split_duration")
    return Split(*(node.get_parameter(name).value for name in names))


def limits(numbers: Mapping[str, Any]) -> StageLimits:
    """Return the stage's limits from the values of their parameters."""
    return StageLimits(
        speed=numbers["max_base_speed"],
        angular_speed=numbers["max_base_angular_speed"],
        jump=numbers["max_base_jump"],
        timeout=numbers["command_timeout"],
    )


def current_limits(node: Node) -> StageLimits:
    """Return the stage's limits as the parameters are now."""
    return limits({name: node.get_parameter(name).value for name in _LIMITS})


def validate(node: Node, simulation: Validated, changes: list[Parameter]) -> SetParametersResult:
    """Refuse, with the reason, what types and ranges cannot express; changes nothing."""
    reason = next(filter(None, (_refusal(node, simulation, p) for p in changes)), None)
    reason = reason or interaction_parameters.refusal(simulation.plant.current_scene, changes)
    return SetParametersResult(successful=reason is None, reason=reason or "")


def _refusal(node: Node, simulation: Validated, parameter: Parameter) -> str | None:
    name, value = parameter.name, parameter.value
    if name == "use_sim_time" and value != node.get_parameter(name).value:
        return "use_sim_time is read at the start only: restart the node"
    if isinstance(value, float) and not math.isfinite(value):
        return f"{name} = {value}: must be finite"
    if name == "record":
        try:
            replace(simulation.record_folder, folder=value).path()
        except (NeedleSimError, OSError, RuntimeError, ValueError) as error:
            return str(error)
    return None


def recorded(node: Node) -> dict[str, str]:
    """Return all parameters as a session keeps them."""
    names = sorted(node.list_parameters([], depth=0).names)
    return {f"parameter.{name}": repr(node.get_parameter(name).value) for name in names}


def _declare_text(node: Node, name: str) -> str:
    default, live, description = _TEXTS[name]
    descriptor = ParameterDescriptor(description=description, read_only=not live)
    return str(_declared(node, name, default, descriptor))


def _declare_number(node: Node, name: str, number: _Number) -> float:
    span = FloatingPointRange(from_value=number.lowest, to_value=number.highest)
    descriptor = ParameterDescriptor(
        description=number.description, read_only=not number.live, floating_point_range=[span]
    )
    value = float(_declared(node, name, number.default, descriptor))
    if not math.isfinite(value):
        raise ParameterError(f"parameter {name} = {value}: must be finite")
    return value


def _declare_core(node: Node) -> int:
    name = "dedicated_core"
    descriptor = ParameterDescriptor(
        description="Processor for the clock loop alone, which waits there awake; -1: none.",
        read_only=True,
    )
    core = int(_declared(node, name, -1, descriptor))
    if core == -1:
        return core
    if node.get_parameter("use_sim_time").value:
        raise ParameterError(f"parameter {name} = {core}: use_sim_time waits for another clock")
    reason = own_core.why_not(core)
    if reason:
        raise ParameterError(f"parameter {name} = {core}: {reason}")
    return core


def _declare_awake(node: Node, core: int) -> bool:
    name = "keep_awake"
    descriptor = ParameterDescriptor(
        description="Keep the processors that the node may use from sleeping between ticks.",
        read_only=True,
    )
    wanted = bool(_declared(node, name, False, descriptor))
    reason = awake.why_not() if core == -1 else f"the loop waits awake on dedicated_core = {core}"
    if wanted and reason:
        raise ParameterError(f"parameter {name} = {wanted}: {reason}")
    return wanted


def _declared(node: Node, name: str, default: object, descriptor: ParameterDescriptor) -> Any:
    if node.has_parameter(name):  # configured before, and cleaned up
        return node.get_parameter(name).value
    try:
        return node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException as error:
        raise ParameterError(_wrong_type(name, str(error), default)) from None
    except ParameterException as error:
        span, value = descriptor.floating_point_range, re.search(r"value \((.*?)\)", str(error))
        if not span or value is None:
            raise ParameterError(f"parameter {name}: {error}") from None
        allowed = f"{span[0].from_value:g} to {span[0].to_value:g}"
        raise ParameterError(f"parameter {name} = {value[1]}: must be {allowed}") from None


def _wrong_type(name: str, error: str, default: object) -> str:
    match = re.search(r"to '(.*)' of type '(\w+)'", error, flags=re.DOTALL)
    if match is None:
        return f"parameter {name}: {error}"
    value, kind = match[1], match[2].lower()
    if isinstance(default, float) and kind == "integer":
        return f"parameter {name} = {value} is an integer: write {value}.0"
    kinds = {
        bool: "true or false",
        int: "an integer",
        float: "a number with a decimal point",
        str: "a string",
    }
    return f"parameter {name} = {value} is of type {kind}: must be {kinds[type(default)]}"


def _overrides(text: str) -> dict[str, object]:
    """Return dotted keys and values of `KEY=VALUE; KEY=VALUE`, values as in YAML."""
    changes: dict[str, object] = {}
    for item in filter(str.strip, text.split(";")):
        key, equals, value = item.partition("=")
        if not equals:
            raise ParameterError(f"parameter scene_overrides: {item.strip()!r} is not KEY=VALUE")
        try:
            changes[key.strip()] = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ParameterError(
                f"parameter scene_overrides: {value.strip()!r} is not a YAML value"
            ) from None
    return changes


def _declare_interaction(node: Node, scene: Scene) -> Scene:
    """Declare `interaction.*` with the scene's values; return the scene with what was set."""
    changes: dict[str, object] = {}
    for name, default, descriptor in interaction_parameters.described(scene):
        value = _declared(node, name, default, descriptor)
        if not math.isfinite(value):
            raise ParameterError(f"parameter {name} = {value}: must be finite")
        if value != default:
            changes[name] = value
    return scene.with_changes(changes) if changes else scene


def _check_rate(scene: Scene, rate: float) -> None:
    """Refuse a tick that Newmark's step does not divide."""
    if scene.solver.dynamics != "newmark":
        return
    step = scene.solver.time_step
    steps = 1.0 / rate / step
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        raise ParameterError(
            f"parameter rate = {rate:g}: a tick of {1 / rate:g} s is not a whole multiple of the "
            f"scene's solver.time_step, {step:g} s; set rate to {1 / step:g}, or scene_overrides "
            f"to solver.time_step={1 / rate:g}"
        )
