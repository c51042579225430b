# SPDX-License-Identifier: Apache-2.0
"""The other side of the node's topics: a stage that commands it and waits for answers."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

import rclpy
from geometry_msgs.msg import TwistStamped, WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.command import BaseCommand

_DISCOVERY = 30.0  # s; usually 0.05, seen to take several under load
_ANSWER = 20.0  # s, for one service call
_RESEND = 0.5  # s
_ATTEMPTS = 20
_SPIN = 0.05  # s
_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class Driver:
    """Commands the node over topics and services; close it, or use it in a ``with`` block.

    Parameters
    ----------
    domain : int
        ROS domain id.
    check : callable
        Called while waiting, every 50 ms or more often; raises to end the waiting.
    node : str
        Name of the node to drive.

    Attributes
    ----------
    time : float
        Simulated time of the node's newest tick that was heard of, s.
    """

    def __init__(
        self, domain: int, check: Callable[[], None] = lambda: None, node: str = "needle_sim"
    ) -> None:
        self._check = check
        self._context = Context()
        # Signals stay with the caller, whose `check` may act on them.
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
        self._ticks = self._listen()
        self.time = 0.0
        self._parameters = self._client(SetParameters, f"{node}/set_parameters")

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

    def pause(self, paused: bool) -> dict[str, Any]:
        """Stop the node's clock or let it run; return what the node says of itself."""
        return self._status(self._call(self._pause, SetBool.Request(data=paused)))

    def reset(self) -> None:
        """Send the simulation back to its start; what it said before is not heard any more."""
        self._node.destroy_subscription(self._ticks)
        self._call(self._reset, Trigger.Request())
        self._ticks, self.time = self._listen(), 0.0
        heard = self._ticks.get_publisher_count
        self._wait(lambda: heard() > 0, _DISCOVERY, "the node's ticks did not appear")

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
        """Let the paused node make one tick; return what it says: time, ticks and so on."""
        return self._status(self._call(self._step, Trigger.Request()))

    def send(self, command: BaseCommand) -> None:
        """Publish a command's velocities, m/s and rad/s in the tissue frame."""
        message = TwistStamped()
        parts = (
            (message.twist.linear, command.velocity),
            (
                message.twist.angular,
                command.angular_velocity,
            ),
        )
        for vector, values in parts:
            if values is not None:
                vector.x, vector.y, vector.z = values.tolist()
        self._publisher.publish(message)

    def deliver(self, command: BaseCommand) -> None:
        """Publish a command's velocities and wait until the paused node has received them.

        The subscription is best effort, so what does not arrive is sent again: the
        same command twice is the same command.
        """
        before = self.pause(True)["commands_received"]
        for _ in range(_ATTEMPTS):
            self.send(command)
            deadline = time.monotonic() + _RESEND
            while time.monotonic() < deadline:
                if self.pause(True)["commands_received"] > before:
                    return
        raise NeedleSimError("the node does not receive commands")

    def wait_tick(self) -> None:
        """Wait for the running node's next tick."""
        now = self.time
        self._wait(lambda: self.time > now, _ANSWER, "the node does not tick")

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _listen(self) -> Subscription:
        kind, name = WrenchStamped, "base_wrench"
        return self._node.create_subscription(kind, name, self._ticked, _RELIABLE)

    def _ticked(self, message: WrenchStamped) -> None:
        stamp = message.header.stamp
        self.time = stamp.sec + 1e-9 * stamp.nanosec

    def _client(self, kind: Any, name: str) -> Client:
        return self._node.create_client(kind, name)

    @staticmethod
    def _status(response: Any) -> dict[str, Any]:
        status: dict[str, Any] = json.loads(response.message)
        return status

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
