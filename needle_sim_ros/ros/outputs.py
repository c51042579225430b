# SPDX-License-Identifier: Apache-2.0
"""The node's publishers as sinks of bytes that know whether anybody listens."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from needle_sim_ros.ros.outlet import Sink
from needle_sim_ros.session import channels
from needle_sim_ros.session.channels import Channel

_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class Outputs:
    """Publishers of everything that the node says.

    Parameters
    ----------
    node : Node
        Publishes.
    clock : bool
        Whether ``/clock`` is among the topics.

    Attributes
    ----------
    sinks : dict of Channel to Sink
    """

    def __init__(self, node: Node, clock: bool) -> None:
        self._node = node
        self._publishers: list[Publisher] = []
        self.sinks: dict[Channel, Sink] = {}
        for channel in (
            *channels.OUTPUTS,
            *channels.RECORDS,
            *((channels.CLOCK,) if clock else ()),
        ):
            self.sinks[channel] = self._sink(channel)

    def destroy(self) -> None:
        """Take the publishers off the node."""
        for publisher in self._publishers:
            self._node.destroy_publisher(publisher)

    def _sink(self, channel: Channel) -> Sink:
        package, _, kind = channel.type.split("/")
        message = getattr(import_module(f"{package}.msg"), kind)
        hearers = _Hearers()
        try:
            events = PublisherEventCallbacks(matched=hearers.changed)
            publisher = self._node.create_publisher(
                message, channel.name, _RELIABLE, event_callbacks=events
            )
            wanted: Any = hearers.any
        except UnsupportedEventTypeError:  # not every middleware tells
            publisher = self._node.create_publisher(message, channel.name, _RELIABLE)
            wanted = publisher.get_subscription_count
        self._publishers.append(publisher)
        return Sink(wanted, publisher.publish)


class _Hearers:
    """Number of subscribers of a topic as the middleware tells: asking costs every tick."""

    def __init__(self) -> None:
        self._count = 0

    def changed(self, status: Any) -> None:
        self._count = status.current_count

    def any(self) -> bool:
        return self._count > 0
