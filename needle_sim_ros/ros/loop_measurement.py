# SPDX-License-Identifier: Apache-2.0
"""How well the node's loop holds its rate: the real node in real time, watched from outside."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped, Vector3Stamped, WrenchStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.domain import free_domain
from needle_sim_ros.ros.node_process import NodeProcess
from needle_sim_ros.scene import Scene, Segment

_START = 120.0  # s; large meshes take long to prepare
_DIAGNOSTICS = 10.0  # s to wait for the next one
_STAGE_PERIOD = 0.02  # s between commands
_OUTPUTS = {
    "tip_deflection": Vector3Stamped,
    "base_wrench": WrenchStamped,
    "tissue_markers": PointCloud2,
}


def measure_loop(scene: Scene, record: bool, subscribe: bool) -> dict[str, Any]:
    """Drive the scene's protocol through the node in real time, one tick per ``time_step``.

    Parameters
    ----------
    scene : Scene
    record : bool
        Record the session meanwhile.
    subscribe : bool
        Subscribe to the outputs in this process; else only to the diagnostics.

    Returns
    -------
    dict
        ``ticks`` and ``overruns`` over the protocol; ``median_ms``, ``p99_ms`` and ``max_ms``
        of the latest 2000 ticks, publishing included; ``lateness_p99_ms``.

    Raises
    ------
    NeedleSimError
        When the node does not start or does not answer.
    """
    with tempfile.TemporaryDirectory(prefix="needle_sim_") as folder:
        place = Path(folder)
        (place / "scene.yaml").write_text(scene.to_yaml(), encoding="utf-8")
        parameters: dict[str, object] = {
            "scene": str(place / "scene.yaml"),
            "rate": 1.0 / scene.solver.time_step,
        }
        if record:
            parameters["record"] = str(place / "bags")
        domain = free_domain()
        with NodeProcess(parameters, domain, place / "node.log") as node:
            stage = _Stage(domain, node.check, subscribe)
            try:
                before = stage.next_values(_START)
                for segment in scene.protocol:
                    stage.follow(segment)
                after = stage.next_values(_DIAGNOSTICS)
            finally:
                stage.close()
    return {
        "ticks": int(after["ticks"]) - int(before["ticks"]),
        "overruns": int(after["overruns"]) - int(before["overruns"]),
        "median_ms": float(after["tick_p50_ms"]),
        "p99_ms": float(after["tick_p99_ms"]),
        "max_ms": float(after["tick_max_ms"]),
        "lateness_p99_ms": float(after["lateness_p99_ms"]),
    }


class _Stage:
    """Publishes stage velocities and keeps what the node says about its loop."""

    def __init__(self, domain: int, check: Callable[[], None], subscribe: bool) -> None:
        self._check = check
        self._values: dict[str, str] | None = None
        self._context = Context()
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node("needle_sim_stage", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._publisher = self._node.create_publisher(TwistStamped, "stage_velocity", 10)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 10)
        for topic, kind in _OUTPUTS.items() if subscribe else ():
            self._node.create_subscription(kind, topic, lambda _: None, 10)

    def follow(self, segment: Segment) -> None:
        """Command the twist of a segment of the protocol for its duration."""
        message = TwistStamped()
        linear, angular = message.twist.linear, message.twist.angular
        linear.x, linear.y, linear.z = map(float, segment.velocity)
        angular.x, angular.y, angular.z = map(float, segment.angular_velocity)
        end = time.monotonic() + segment.duration
        while time.monotonic() < end:
            self._publisher.publish(message)
            self._spin(min(end, time.monotonic() + _STAGE_PERIOD))

    def next_values(self, patience: float) -> dict[str, str]:
        """Wait for the next diagnostics of the loop and return its values."""
        self._values = None
        deadline = time.monotonic() + patience
        while self._values is None:
            self._spin(time.monotonic() + _STAGE_PERIOD)
            if time.monotonic() > deadline:
                raise NeedleSimError(f"the node sent no diagnostics within {patience:g} s")
        return self._values

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _spin(self, until: float) -> None:
        self._check()
        while (left := until - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def _diagnosed(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "overruns" in values:
                self._values = values
