# SPDX-License-Identifier: Apache-2.0
"""The topics `visualization` and `needle_shape`, for RViz and Foxglove.

Made from the last observation, which never changes, in a thread of its own, and only while
somebody listens: a tick pays nothing for it. The tissue's whole field costs a solve, so the
thread rests at least as long as three times what it took.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from visualization_msgs.msg import MarkerArray

from needle_sim_ros.observation import Observation
from needle_sim_ros.ros.marker_array import marker_array
from needle_sim_ros.ros.plant import Plant
from needle_sim_ros.session.writer import nanoseconds
from needle_sim_ros.view.shapes import Shapes

_REST = 3.0  # times what the last one took
_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


class Visualization:
    """Publishes shapes and the needle's line while somebody listens.

    Parameters
    ----------
    node : Node
        Publishes; its parameter `visualization_rate` is read as it goes.
    plant : Plant
        What is shown.
    frame : str
        Tissue frame.
    """

    def __init__(self, node: Node, plant: Plant, frame: str) -> None:
        self._node, self._plant, self._frame = node, plant, frame
        self._markers = node.create_publisher(MarkerArray, "visualization", _QOS)
        self._line = node.create_publisher(Path, "needle_shape", _QOS)
        self._shapes: Shapes | None = None
        self._shown: dict[str, tuple[Observation | None, int]] = {}
        self.rounds = 0  # in which something was published
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="visualization", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; the context must still be valid."""
        self._closing.set()
        self._thread.join()

    def destroy(self) -> None:
        """Close, and take the publishers off the node."""
        self.close()
        for publisher in (self._markers, self._line):
            self._node.destroy_publisher(publisher)

    def _run(self) -> None:
        wait = 0.0
        while not self._closing.wait(wait):
            begun = time.monotonic()
            try:
                self._round()
            except Exception as error:  # a picture that fails must not take the node along
                self._node.get_logger().error(
                    f"visualization: {error!r}", throttle_duration_sec=5.0
                )
            took = time.monotonic() - begun
            rate = float(self._node.get_parameter("visualization_rate").value)
            wait = max(1.0 / rate - took, _REST * took)

    def _round(self) -> None:
        seen = self._plant.last_observation
        if seen is None:
            return
        done = [
            self._show("markers", self._markers.get_subscription_count(), seen, self._show_shapes),
            self._show("line", self._line.get_subscription_count(), seen, self._show_line),
        ]
        self.rounds += any(done)

    def _show(
        self, name: str, hearers: int, seen: Observation, show: Callable[[Observation], None]
    ) -> bool:
        """Show what is new to one of those who listen; say whether anything was."""
        fresh = bool(hearers) and self._shown.get(name) != (seen, hearers)
        if fresh:
            show(seen)
        self._shown[name] = (seen, hearers)
        return fresh

    def _show_shapes(self, seen: Observation) -> None:
        if self._shapes is None:
            self._shapes = Shapes(self._plant.scene)
        shapes = self._shapes.of(seen, lambda points: self._plant.tissue_displacement(points, seen))
        self._markers.publish(marker_array(nanoseconds(seen.time), self._frame, shapes))

    def _show_line(self, seen: Observation) -> None:
        path = Path()
        path.header.frame_id = self._frame
        stamp = path.header.stamp
        stamp.sec, stamp.nanosec = divmod(nanoseconds(seen.time), 1_000_000_000)
        for x, y, z in seen.needle_points.tolist():
            pose = PoseStamped(header=path.header)
            position = pose.pose.position
            position.x, position.y, position.z = x, y, z
            path.poses.append(pose)
        self._line.publish(path)
