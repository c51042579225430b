# SPDX-License-Identifier: Apache-2.0
"""The other side of the node's topics: a stage that commands it and waits for answers."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.errors import NeedleSimError

_DISCOVERY = 30.0  # s; usually 0.05, seen to take several under load
_ANSWER = 20.0  # s, for one service call
_RESEND = 1.5  # s; longer than the period of the node's diagnostics
_SPIN = 0.05  # s
_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class Driver:
    """Commands the node over topics and services; close it, or use it in a ``with`` block.

    Parameters
    ----------
    domain : int
        ROS domain id.
    check : callable
        Called while waiting; raises when waiting has become pointless.
    node : str
        Name of the node to drive.
    """

    def __init__(
        self, domain: int, check: Callable[[], None] = lambda: None, node: str = "needle_sim"
    ) -> None:
        self._check = check
        self._context = Context()
        # Ctrl-C stays Python's KeyboardInterrupt.
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node("needle_sim_driver", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publisher = self._node.create_publisher(TwistStamped, "stage_velocity", _RELIABLE)
        self._step = self._client(Trigger, f"{node}/step")
        self._reset = self._client(Trigger, f"{node}/reset")
        self._pause = self._client(SetBool, f"{node}/pause")
        self._record = self._client(SetBool, f"{node}/record")
        self._parameters = self._client(SetParameters, f"{node}/set_parameters")
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, _RELIABLE)
        self._sent = 0
        self._received = 0
        self._received_before = 0

    def __enter__(self) -> Driver:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def wait_ready(self) -> None:
        """Wait until every service and the command's subscription are there.

        Raises
        ------
        NeedleSimError
            When that takes longer than half a minute, or the node has ended.
        """
        clients = (self._step, self._reset, self._pause, self._record, self._parameters)

        def ready() -> bool:
            return self._publisher.get_subscription_count() > 0 and all(
                client.service_is_ready() for client in clients
            )

        self._wait(ready, _DISCOVERY, "the node did not appear")

    def pause(self, paused: bool) -> None:
        """Stop the node's clock, or let it run."""
        self._call(self._pause, SetBool.Request(data=paused))

    def reset(self) -> None:
        """Send the simulation back to its start."""
        self._call(self._reset, Trigger.Request())

    def record(self, on: bool) -> str:
        """Begin or finish a recording; return what the node says about it."""
        return str(self._call(self._record, SetBool.Request(data=on)).message)

    def set_parameter(self, name: str, value: str) -> None:
        """Set a text parameter of the node."""
        content = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=content)])
        result = self._answer(self._parameters, request).results[0]
        if not result.successful:
            raise NeedleSimError(f"the node refuses {name} = {value}: {result.reason}")

    def step(self) -> dict[str, Any]:
        """Let the paused node make one tick; return what it says: time, ticks, commands_received."""
        answer: dict[str, Any] = json.loads(self._call(self._step, Trigger.Request()).message)
        self._received = max(self._received, int(answer["commands_received"]))
        return answer

    def send(self, velocity: Sequence[float], angular_velocity: Sequence[float]) -> None:
        """Publish a stage velocity, m/s and rad/s in the tissue frame."""
        message = TwistStamped()
        linear, angular = message.twist.linear, message.twist.angular
        linear.x, linear.y, linear.z = map(float, velocity)
        angular.x, angular.y, angular.z = map(float, angular_velocity)
        self._sent += 1
        self._publisher.publish(message)

    def deliver(self, velocity: Sequence[float], angular_velocity: Sequence[float]) -> None:
        """Publish a stage velocity and wait until the node has received it.

        The subscription is best effort, so what does not arrive is sent again: the
        same command twice is the same command.
        """
        before = self._received
        deadline = time.monotonic() + _ANSWER
        while self._received <= before:
            self.send(velocity, angular_velocity)
            self._spin_until(lambda: self._received > before, _RESEND)
            if time.monotonic() > deadline:
                raise NeedleSimError("the node does not receive commands")

    def spin(self, duration: float) -> None:
        """Take in messages for a time, s."""
        self._spin_until(lambda: False, duration)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _client(self, kind: Any, name: str) -> Client:
        return self._node.create_client(kind, name)

    def _diagnosed(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for pair in status.values:
                if pair.key == "commands_received":
                    self._received = max(self._received, int(pair.value))

    def _call(self, client: Client, request: Any) -> Any:
        response = self._answer(client, request)
        if not response.success:
            raise NeedleSimError(f"{client.srv_name}: {response.message}")
        return response

    def _answer(self, client: Client, request: Any) -> Any:
        future = client.call_async(request)
        self._wait(future.done, _ANSWER, f"{client.srv_name} did not answer")
        return future.result()

    def _wait(self, condition: Callable[[], bool], patience: float, complaint: str) -> None:
        if not self._spin_until(condition, patience):
            raise NeedleSimError(f"{complaint} within {patience:g} s")

    def _spin_until(self, condition: Callable[[], bool], patience: float) -> bool:
        deadline = time.monotonic() + patience
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, _SPIN))
            self._check()
        return True
