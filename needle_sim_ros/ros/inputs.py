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
from needle_sim_ros.ros.receiver import Receiver
from needle_sim_ros.session import cdr, channels
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
        self._receiver = Receiver(
            node,
            [
                (channels.BASE_POSE.name, PoseStamped, self._take_pose),
                (channels.STAGE_VELOCITY.name, TwistStamped, self._take_velocity),
            ],
            _BEST_EFFORT,
            plant.give_way,
        )

    def publishers(self) -> dict[str, int]:
        """Return how many publish on each command topic."""
        names = (channels.BASE_POSE.name, channels.STAGE_VELOCITY.name)
        return {name: self._node.count_publishers(name) for name in names}

    def stop(self) -> None:
        """Take no commands any more."""
        self._receiver.stop()

    def destroy(self) -> None:
        """Take the subscriptions off the node."""
        self._receiver.destroy()

    def _take_pose(self, data: bytes) -> None:
        channel = channels.BASE_POSE
        read = self._read(data, 7, PoseStamped, channel)
        if read is not None:
            frame, numbers = read
            plant = self._plant
            position, orientation = numbers[:3], numbers[3:]
            reason = plant.commands.pose(position, orientation, frame, plant.time, plant.position)
            self._warn_rejected(channel, reason)

    def _take_velocity(self, data: bytes) -> None:
        channel = channels.STAGE_VELOCITY
        read = self._read(data, 6, TwistStamped, channel)
        if read is not None:
            frame, numbers = read
            plant = self._plant
            reason = plant.commands.velocity(numbers[:3], numbers[3:], frame, plant.time)
            self._warn_rejected(channel, reason)

    def _read(
        self, data: bytes, count: int, kind: Any, channel: Channel
    ) -> tuple[str, tuple[float, ...]] | None:
        """Return frame id and numbers of a message, recorded as it came; None if it is none."""
        read = cdr.read_stamped_doubles(data, count)
        if read is None or len(data) > _LARGEST_COMMAND:
            try:
                message = deserialize_message(data, kind)
            except Exception:
                self._warn_rejected(channel, self._plant.commands.unreadable())
                return None
            if len(data) > _LARGEST_COMMAND or "\ufffd" in message.header.frame_id:
                # Text that is no UTF-8, or slack after the message, would end other readers.
                data = serialize_message(message)
            read = message.header.frame_id, _numbers(message)
        self._plant.record(channel, data)
        return read

    def _warn_rejected(self, channel: Channel, reason: str | None) -> None:
        if reason is not None:
            self._warn(f"command on {channel.name} ignored: {reason}")


def _numbers(message: PoseStamped | TwistStamped) -> tuple[float, ...]:
    if isinstance(message, PoseStamped):
        p, q = message.pose.position, message.pose.orientation
        return p.x, p.y, p.z, q.x, q.y, q.z, q.w
    v, w = message.twist.linear, message.twist.angular
    return v.x, v.y, v.z, w.x, w.y, w.z
