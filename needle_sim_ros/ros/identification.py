# SPDX-License-Identifier: Apache-2.0
"""Online identification on the node: measured wrench and markers in, parameters out.

Nothing of it exists unless the parameter `identify` is true.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.identify.online import Estimate
from needle_sim_ros.identify.online_process import EstimatorProcess
from needle_sim_ros.identify.parameters import PARAMETERS
from needle_sim_ros.session.topics import cloud_points

if TYPE_CHECKING:
    from collections.abc import Callable

    from needle_sim_ros.observation import Observation
    from needle_sim_ros.scene import Scene
    from needle_sim_ros.session.motion import Motion

TOPIC = "identified_parameters"
_BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
_PERIOD = 0.5  # s between messages
_SURE = 0.1  # relative standard error below which a value is applied
_WORTH = 0.01  # relative change from which a value is applied again


class Watched(Protocol):
    """What of the plant is needed here."""

    scene: Scene
    period: float
    time: float
    watch: Callable[[Observation, Motion], object] | None


class Identification:
    """Feeds the estimator with every tick and every measurement; publishes what it finds.

    A measurement counts for the simulated time at which it arrives: sensors keep to the
    wall clock, and the simulation does too unless it is paused.

    Parameters
    ----------
    node : Node
    plant : Watched
        Its ``watch`` is taken.
    """

    def __init__(self, node: Node, plant: Watched) -> None:
        self._node, self._plant = node, plant
        self._estimator = EstimatorProcess(plant.scene, plant.period)
        self._rest = np.array(plant.scene.markers, dtype=float).reshape(-1, 3)
        self._last = 0.0
        self._ignored = 0
        self._applied: dict[str, float] = {}
        self._refusal = ""
        self._subscriptions = [
            node.create_subscription(WrenchStamped, "measured_wrench", self._wrench, _BEST_EFFORT),
            node.create_subscription(PointCloud2, "measured_markers", self._markers, _BEST_EFFORT),
        ]
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, _RELIABLE)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", _RELIABLE)
        self._timer = node.create_timer(_PERIOD, self._publish, clock=Clock())
        plant.watch = self._tick

    @classmethod
    def wanted(cls, node: Node, plant: Watched) -> Identification | None:
        """Declare the parameters; return the identification when `identify` is true."""
        declared = {}
        for name, live, text in (
            ("identify", False, "Estimate parameters from measured_wrench and measured_markers."),
            ("identify_apply", True, "Set interaction.* to estimates that are known to 10 %."),
        ):
            descriptor = ParameterDescriptor(description=text, read_only=not live)
            if not node.has_parameter(name):
                node.declare_parameter(name, False, descriptor)
            declared[name] = node.get_parameter(name).value
        return cls(node, plant) if declared["identify"] else None

    def close(self) -> None:
        """End the estimator's process."""
        self._plant.watch = None
        self._estimator.close()

    def destroy(self) -> None:
        """Close, and take subscriptions, publishers and timer off the node."""
        self.close()
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in (self._publisher, self._diagnostics):
            self._node.destroy_publisher(publisher)

    def _tick(self, observation: Observation, motion: Motion) -> None:
        if observation.time <= self._last:
            self._estimator.reset()
        self._last = observation.time
        self._estimator.tick(motion)

    def _wrench(self, message: WrenchStamped) -> None:
        force = message.wrench.force
        numbers = (force.x, force.y, force.z)
        if any(math.isinf(number) for number in numbers):
            self._ignored += 1
            return
        self._estimator.measure(self._plant.time, numbers)

    def _markers(self, message: PointCloud2) -> None:
        try:
            places = cloud_points(message, "measured_markers")
        except (NeedleSimError, ValueError, KeyError):
            self._ignored += 1
            return
        if places.shape != self._rest.shape or np.isinf(places).any():
            self._ignored += 1
            return
        self._estimator.measure(self._plant.time, None, places - self._rest)

    def _publish(self) -> None:
        estimate = self._estimator.latest()
        if estimate is not None and self._node.get_parameter("identify_apply").value:
            self._apply(estimate)
        message = DiagnosticArray()
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(round(self._plant.time * 1e9), 1_000_000_000)
        message.status = [self._status(estimate)]
        self._publisher.publish(message)
        self._diagnostics.publish(message)

    def _status(self, estimate: Estimate | None) -> DiagnosticStatus:
        level, text = DiagnosticStatus.OK, "waiting for measurements"
        values: dict[str, Any] = {}
        if estimate is not None and estimate.samples:
            text = "estimating"
            for name, value in estimate.values.items():
                values[name] = f"{value:.6g}"
                values[f"{name}.standard_error"] = f"{estimate.standard_errors[name]:.3g}"
                values[f"{name}.unit"] = PARAMETERS[name].unit
            values |= {"time_s": f"{estimate.time:.3f}", "samples": estimate.samples}
        values |= {"ignored_measurements": self._ignored}
        if self._applied:
            values["applied"] = ", ".join(f"{k} = {v:.4g}" for k, v in self._applied.items())
        if self._refusal:
            level, text = DiagnosticStatus.WARN, f"not applied: {self._refusal}"
        if self._estimator.problem:
            level, text = DiagnosticStatus.ERROR, self._estimator.problem
        pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        name = f"{self._node.get_fully_qualified_name()[1:]}: identification"
        return DiagnosticStatus(level=level, name=name, message=text, values=pairs)

    def _apply(self, estimate: Estimate) -> None:
        """Set the laws through the node's own parameters, as anybody might."""
        known = {
            name: value
            for name, value in estimate.values.items()
            if PARAMETERS[name].key.startswith("interaction.")
            and estimate.standard_errors[name] < _SURE * value
        }
        if "friction.kinetic" in known:
            friction = self._plant.scene.interaction.friction
            ratio = friction.static / friction.kinetic if friction.kinetic > 0 else 1.0
            known["friction.static"] = ratio * known["friction.kinetic"]
        changed = {n: v for n, v in known.items() if self._differs(n, v, self._applied)}
        if not changed:
            return
        parameters = [Parameter(f"interaction.{n}", value=v) for n, v in changed.items()]
        result = self._node.set_parameters_atomically(parameters)
        self._refusal = "" if result.successful else str(result.reason)
        if result.successful:
            self._applied |= changed

    @staticmethod
    def _differs(name: str, value: float, applied: Mapping[str, float]) -> bool:
        before = applied.get(name)
        return before is None or abs(value - before) > _WORTH * abs(before)
