# SPDX-License-Identifier: Apache-2.0
"""A controller in a page: it turns the needle about its entry until the tip heads for a target.

    ros2 run needle_sim_ros sim_node --ros-args -p scene:=gao2016 -p rate:=50.0
    python3 doc/examples/proportional_steering.py --ros-args -p marker:=3

Every tick it reads where tip, base and target are and answers with a twist of the base: forward
along the needle, and turning about the entry at a rate in proportion to the angle between where
the tip heads and where the target is. It stops when the target is beside the tip.
"""

from __future__ import annotations

import contextlib
import sys

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from needle_sim_ros.geometry import rotation_matrix

GAIN = 8.0  # rad/s of turn per rad of heading error
FASTEST_TURN = 0.3  # rad/s


class ProportionalSteering(Node):
    """Subscribes to tip, base and markers; publishes the velocity of the base."""

    def __init__(self, **options) -> None:
        super().__init__("proportional_steering", **options)
        self.speed = self.declare_parameter("speed", 0.01).value  # m/s
        self.marker = self.declare_parameter("marker", 1).value  # counted from 1
        self.base = self.target = None
        self.miss: float | None = None  # m, once the target is reached
        self.stage = self.create_publisher(TwistStamped, "stage_velocity", 10)
        self.create_subscription(PoseStamped, "needle_sim/stage_pose", self.see_base, 10)
        self.create_subscription(PointCloud2, "tissue_markers", self.see_markers, 10)
        self.create_subscription(PoseStamped, "tip_pose", self.steer, 10)

    def see_base(self, message: PoseStamped) -> None:
        """Note where the base is."""
        self.base = place_and_axis(message)

    def see_markers(self, message: PointCloud2) -> None:
        """Note where the target has been pushed to."""
        rows = np.frombuffer(message.data, "<f4").reshape(message.width, -1)
        self.target = rows[self.marker - 1, :3].astype(float)

    def steer(self, message: PoseStamped) -> None:
        """Answer a tick with the base's next velocity."""
        if self.base is None or self.target is None or self.miss is not None:
            return
        tip, heading = place_and_axis(message)
        to_target = self.target - tip
        if to_target @ heading <= 0:
            self.miss = float(np.linalg.norm(to_target))
            self.send(np.zeros(3), np.zeros(3))
            self.get_logger().info(f"target reached, miss {1e3 * self.miss:.2f} mm")
            return
        turn = np.zeros(3)
        if tip[2] < 0:  # in the tissue
            error = np.cross(heading, to_target / np.linalg.norm(to_target))
            turn = np.clip(GAIN * error, -FASTEST_TURN, FASTEST_TURN)
        position, axis = self.base
        entry = position - axis * position[2] / axis[2]
        self.send(self.speed * axis + np.cross(turn, position - entry), turn)

    def send(self, velocity: np.ndarray, turn: np.ndarray) -> None:
        """Publish a twist of the base, tissue frame."""
        message = TwistStamped()
        message.header.frame_id = "tissue"
        message.header.stamp = self.get_clock().now().to_msg()
        linear, angular = message.twist.linear, message.twist.angular
        linear.x, linear.y, linear.z = velocity.tolist()
        angular.x, angular.y, angular.z = turn.tolist()
        self.stage.publish(message)


def place_and_axis(message: PoseStamped) -> tuple[np.ndarray, np.ndarray]:
    """Return position and z axis of a pose."""
    p, q = message.pose.position, message.pose.orientation
    return np.array([p.x, p.y, p.z]), rotation_matrix([q.x, q.y, q.z, q.w])[:, 2]


def main() -> None:
    """Steer until the target is reached."""
    rclpy.init(args=sys.argv)
    node = ProportionalSteering()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        while node.miss is None:
            rclpy.spin_once(node)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
