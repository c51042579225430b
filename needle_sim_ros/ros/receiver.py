# SPDX-License-Identifier: Apache-2.0
"""Subscriptions read in a thread of their own instead of by the node's executor.

rclpy's executor looks at every service, timer and event of the node for each message,
which at 1 kHz takes more of a processor than the simulation does. A wait set with nothing
but the subscriptions takes a tenth of that, and waits without the interpreter lock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile

_LONGEST_WAIT = 500_000_000  # ns, so that a stop is noticed even if waking fails


class _OwnThread(CallbackGroup):
    """Entities of this group are none of the executor's business."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return None


class Receiver:
    """Takes the bytes of messages as they come.

    Parameters
    ----------
    node : Node
        Subscribes.
    topics : iterable of (str, type, callable)
        Topic, message type, and taker of the serialised messages; a topic may be there twice.
    qos : QoSProfile
        Of all of them.
    give_way : callable
        Called before each message is taken; may wait a little for something more urgent.
    """

    def __init__(
        self,
        node: Node,
        topics: Iterable[tuple[str, Any, Callable[[bytes], None]]],
        qos: QoSProfile,
        give_way: Callable[[], object] = lambda: None,
    ) -> None:
        self._node = node
        self._give_way = give_way
        group = _OwnThread()
        self._subscriptions = [
            node.create_subscription(kind, name, take, qos, callback_group=group, raw=True)
            for name, kind, take in topics
        ]
        self._wake = _rclpy.GuardCondition(node.context.handle)
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="commands", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread: nothing is taken any more."""
        self._stopping = True
        if self._node.context.ok():
            self._wake.trigger_guard_condition()
        self._thread.join()

    def destroy(self) -> None:
        """End the thread and take the subscriptions off the node."""
        self.stop()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _run(self) -> None:
        subscriptions = self._subscriptions
        context = self._node.context
        wait_set = _rclpy.WaitSet(len(subscriptions), 1, 0, 0, 0, 0, context.handle)
        while not self._stopping:
            wait_set.clear_entities()
            for subscription in subscriptions:
                wait_set.add_subscription(subscription.handle)
            wait_set.add_guard_condition(self._wake)
            try:
                wait_set.wait(_LONGEST_WAIT)
            except _rclpy.RCLError:
                if not context.ok():  # shut down while we waited
                    return
                raise
            ready = wait_set.get_ready_entities("subscription")
            for subscription in subscriptions:
                if subscription.handle.pointer in ready:
                    self._take(subscription)

    def _take(self, subscription: Any) -> None:
        while not self._stopping:
            self._give_way()
            taken = subscription.handle.take_message(subscription.msg_type, True)
            if taken is None:
                return
            try:
                subscription.callback(taken[0])
            except Exception as error:  # whatever it was, the next command must get through
                self._node.get_logger().error(f"a message was not taken: {error!r}")
