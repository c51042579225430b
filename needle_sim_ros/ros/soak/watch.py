# SPDX-License-Identifier: Apache-2.0
"""A driver that also listens to what the node says about itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped

from needle_sim_ros.ros.driver import Driver

_DIAGNOSTICS = 20.0  # s to wait for the next one
_QUEUE = 1000
_DRAIN = 20  # messages


class Watch(Driver):
    """Drives the node and keeps its newest diagnostics, by key.

    Parameters
    ----------
    domain : int
        ROS domain id.
    check : callable
        Called while waiting; raises to end the waiting.
    """

    def __init__(self, domain: int, check: Callable[[], None]) -> None:
        super().__init__(domain, check)
        self._values: dict[str, str] | None = None
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 10)
        for subscription in list(self._node.subscriptions):
            if subscription.topic_name == "/base_wrench":  # one more would change what is measured
                self._node.destroy_subscription(subscription)
        self.publishers = {
            "base_pose": self._node.create_publisher(PoseStamped, "base_pose", _QUEUE),
            "stage_velocity": self._publisher,
        }

    def __enter__(self) -> Watch:
        return self

    def diagnostics(self) -> dict[str, str]:
        """Wait for the next diagnostics and return all their values."""
        self._values = None
        self._wait(lambda: self._values is not None, _DIAGNOSTICS, "no diagnostics came")
        return dict(self._values or {})

    def listen(self, kind: Any, topic: str, take: Callable[[bytes], None]) -> None:
        """Subscribe to a topic's bytes."""
        self._node.create_subscription(kind, topic, take, _QUEUE, raw=True)

    def until(self, condition: Callable[[], bool], patience: float) -> bool:
        """Spin until a condition holds; return whether it did."""
        return self._spin_until(condition, patience)

    def wait_heard(self, topic: str) -> None:
        """Wait until somebody subscribes to a topic."""
        name = topic.replace("~", "needle_sim")
        count = self._node.count_subscribers
        self._wait(lambda: count(name) > 0, _DIAGNOSTICS, f"nobody subscribed to {topic}")

    def drain(self) -> None:
        """Take what has arrived and is still waiting."""
        for _ in range(_DRAIN):
            self._executor.spin_once(timeout_sec=0.005)

    def spin(self, duration: float) -> None:
        """Spin for a time, s."""
        end = time.monotonic() + duration
        self._spin_until(lambda: time.monotonic() >= end, duration + 1.0)

    def _diagnosed(self, message: DiagnosticArray) -> None:
        self._values = {pair.key: pair.value for status in message.status for pair in status.values}
