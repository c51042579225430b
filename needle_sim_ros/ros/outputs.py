# SPDX-License-Identifier: Apache-2.0
"""The node's publishers as sinks of bytes that know whether anybody listens."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

from needle_sim_ros.ros.outlet import Sink
from needle_sim_ros.session import channels
from needle_sim_ros.session.channels import Channel

_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class Outputs:
    """Publishers of everything that the node says; :meth:`refresh` them now and then.

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
        self._publishers: list[tuple[Publisher, Sink]] = []
        self.sinks: dict[Channel, Sink] = {}
        for channel in (
            *channels.OUTPUTS,
            *channels.RECORDS,
            *((channels.CLOCK,) if clock else ()),
        ):
            self.sinks[channel] = self._sink(channel)

    def destroy(self) -> None:
        """Take the publishers off the node."""
        for publisher, _ in self._publishers:
            self._node.destroy_publisher(publisher)

    def refresh(self, pause: Callable[[], object] = lambda: None) -> None:
        """Ask the middleware who listens, with a pause after each topic.

        Asking for every topic in every tick took a tenth of a tick; the middleware's own event
        is dearer still, since the executor then looks at one more thing per topic.
        """
        for publisher, sink in self._publishers:
            sink.wanted = publisher.get_subscription_count() > 0
            pause()

    def _sink(self, channel: Channel) -> Sink:
        package, _, kind = channel.type.split("/")
        message = getattr(import_module(f"{package}.msg"), kind)
        publisher = self._node.create_publisher(message, channel.name, _RELIABLE)
        sink = Sink(publisher.publish)
        self._publishers.append((publisher, sink))
        return sink
