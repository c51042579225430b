# SPDX-License-Identifier: Apache-2.0
"""How well the node's loop holds its rate: the real node in real time, watched from outside."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
from sensor_msgs.msg import PointCloud2

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.driver import Driver
from needle_sim_ros.ros.node_process import NodeProcess
from needle_sim_ros.scene import Scene

_DIAGNOSTICS = 10.0  # s to wait for the next one
_STARTS = 4  # times the driver's own patience: large meshes take long to prepare
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
        Subscribe to the outputs in this process.

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
            "command_timeout": 0.0,
        }
        if record:
            parameters["record"] = str(place / "bags")
        domain = 1 + os.getpid() % 230
        with (
            NodeProcess(parameters, domain, place / "node.log") as node,
            _Watcher(domain, node.check) as watcher,
        ):
            watcher.wait_long()
            if subscribe:
                watcher.subscribe()
            before = watcher.next_values()
            for segment in scene.protocol:
                watcher.deliver(segment.velocity, segment.angular_velocity)
                watcher.spin(segment.duration)
            after = watcher.next_values()
    return {
        "ticks": int(after["ticks"]) - int(before["ticks"]),
        "overruns": int(after["overruns"]) - int(before["overruns"]),
        "median_ms": float(after["tick_p50_ms"]),
        "p99_ms": float(after["tick_p99_ms"]),
        "max_ms": float(after["tick_max_ms"]),
        "lateness_p99_ms": float(after["lateness_p99_ms"]),
    }


class _Watcher(Driver):
    """A driver that keeps what the node says about its loop."""

    _values: dict[str, str] | None = None

    def __enter__(self) -> _Watcher:
        return self

    def _diagnosed(self, message: DiagnosticArray) -> None:
        super()._diagnosed(message)
        for status in message.status:
            values = {pair.key: pair.value for pair in status.values}
            if "overruns" in values:
                self._values = values

    def wait_long(self) -> None:
        """Wait until the node is ready, longer than a driver does."""
        for attempt in range(1, _STARTS + 1):
            try:
                return self.wait_ready()
            except NeedleSimError:
                self._check()
                if attempt == _STARTS:
                    raise

    def subscribe(self) -> None:
        """Subscribe to the outputs and drop what comes."""
        for topic, kind in _OUTPUTS.items():
            self._node.create_subscription(kind, topic, lambda _: None, 10)

    def next_values(self) -> dict[str, str]:
        """Wait for the next diagnostics of the loop and return its values."""
        self._values = None
        deadline = time.monotonic() + _DIAGNOSTICS
        while self._values is None:
            self.spin(0.05)
            if time.monotonic() > deadline:
                raise NeedleSimError(f"the node sent no diagnostics within {_DIAGNOSTICS:g} s")
        return self._values
