# SPDX-License-Identifier: Apache-2.0
"""The node's subscriptions: bytes in, commands for the stage out; everything is recorded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from needle_sim_ros.ros.plant import Plant
from needle_sim_ros.session import channels
from needle_sim_ros.session.channels import Channel

_BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_LARGEST_COMMAND = 1024  # bytes; a pose with a long frame id has some hundred


class Inputs:
    """Takes commands off the topics and gives them to the stage.

    Parameters
    ----------
    node : Node
        Subscribes.
    plant : Plant
        Takes the commands.
    warn : callable
        Told of every command that is refused.
    """

    def __init__(self, node: Node, plant: Plant, warn: Callable[[str], object]) -> None:
        self._node = node
        self._plant = plant
        self._warn = warn
        self._subscriptions = [
            node.create_subscription(message, channel.name, take, _BEST_EFFORT, raw=True)
            for channel, message, take in (
                (channels.BASE_POSE, PoseStamped, self._take_pose),
                (channels.STAGE_VELOCITY, TwistStamped, self._take_velocity),
            )
        ]

    def publishers(self) -> dict[str, int]:
        """Return how many publish on each command topic."""
        names = (channels.BASE_POSE.name, channels.STAGE_VELOCITY.name)
        return {name: self._node.count_publishers(name) for name in names}

    def destroy(self) -> None:
        """Take the subscriptions off the node."""
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _take_pose(self, data: bytes) -> None:
        message = self._read(data, PoseStamped, channels.BASE_POSE)
        if message is not None:
            p, q = message.pose.position, message.pose.orientation
            reason = self._plant.commands.pose(
                (p.x, p.y, p.z),
                (q.x, q.y, q.z, q.w),
                message.header.frame_id,
                self._plant.time,
                self._plant.position,
            )
            self._warn_rejected(channels.BASE_POSE, reason)

    def _take_velocity(self, data: bytes) -> None:
        message = self._read(data, TwistStamped, channels.STAGE_VELOCITY)
        if message is not None:
            v, w = message.twist.linear, message.twist.angular
            reason = self._plant.commands.velocity(
                (v.x, v.y, v.z), (w.x, w.y, w.z), message.header.frame_id, self._plant.time
            )
            self._warn_rejected(channels.STAGE_VELOCITY, reason)

    def _read(self, data: bytes, kind: Any, channel: Channel) -> Any:
        """Return the message, recorded as it came, or None for bytes that are none."""
        try:
            message = deserialize_message(data, kind)
        except Exception:
            self._warn_rejected(channel, self._plant.commands.unreadable())
            return None
        if len(data) > _LARGEST_COMMAND or "\ufffd" in message.header.frame_id:
            # Text that is no UTF-8, or slack after the message, would end other readers.
            data = serialize_message(message)
        self._plant.record(channel, data)
        return message

    def _warn_rejected(self, channel: Channel, reason: str | None) -> None:
        if reason is not None:
            self._warn(f"command on {channel.name} ignored: {reason}")
