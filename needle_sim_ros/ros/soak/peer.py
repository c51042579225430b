# SPDX-License-Identifier: Apache-2.0
"""One process beside the node: commands at a rate, subscribers, or messages nobody wants.

Run as ``python -m needle_sim_ros.ros.soak.peer ROLE FILE [TOPIC ...]`` until SIGTERM; the
domain comes from the environment. What it saw goes into FILE.
"""

from __future__ import annotations

import random
import signal
import struct
import sys
import threading
import time
from array import array
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from needle_sim_ros.ros.receiver import Receiver
from needle_sim_ros.ros.soak.hostile import hostile_message
from needle_sim_ros.session import channels

COMMAND_RATE = 1000.0  # Hz
SPEED = 3e-3  # m/s
HALF_PERIOD = 18.0  # s of insertion, then as long out again
TAG = 1e-15  # m/s of velocity in x per command, by which it is known again
STALL = 0.5  # s that a stalling subscriber sleeps with every message
_HOSTILE_PAUSE = 2e-3  # s between hostile messages
_HOSTILE_LIFE = 1.0  # s that a hostile publisher lives
_STAMP = struct.Struct("<iI")
_TYPES = {channel.name: channel.type for channel in (*channels.OUTPUTS, *channels.RECORDS)}


def commander(node: Node, file: Path, stop: threading.Event) -> None:
    """Send velocities at 1 kHz, each known again by its x; write when each was sent, s."""
    publisher = node.create_publisher(TwistStamped, channels.STAGE_VELOCITY.name, 10)
    message, sent = TwistStamped(), array("d")
    linear = message.twist.linear
    start = due = time.monotonic()
    while not stop.is_set():
        linear.x = TAG * len(sent)
        linear.z = -SPEED if (due - start) % (2 * HALF_PERIOD) < HALF_PERIOD else SPEED
        sent.append(time.monotonic())
        publisher.publish(message)
        due = max(due + 1 / COMMAND_RATE, time.monotonic() - 0.1)
        time.sleep(max(0.0, due - time.monotonic()))
    file.write_bytes(sent.tobytes())


def subscribers(node: Node, file: Path, stop: threading.Event, topics: list[str]) -> None:
    """Subscribe to topics, each as often as it is named; write what came and when.

    A line per topic: its name and the number of messages. A topic ``base_wrench`` and one
    ``applied_velocity`` together give pairs of command's tag and the wrench's arrival, s.
    """
    counts = [0] * len(topics)
    arrived: dict[int, float] = {}
    tags: dict[int, int] = {}

    def taker(index: int, topic: str) -> Callable[[bytes], None]:
        def take(data: bytes) -> None:
            now = time.monotonic()
            counts[index] += 1
            second, nanosecond = _STAMP.unpack_from(data, 4)
            if topic == "base_wrench":
                arrived[second * 10**9 + nanosecond] = now
            elif topic == "~/applied_velocity":
                (x,) = struct.unpack_from("<d", data, _doubles_at(data))
                tags[second * 10**9 + nanosecond] = round(x / TAG)

        return take

    latency = "~/applied_velocity" in topics
    heard = [
        (topic.replace("~", "needle_sim"), _type_of(topic), taker(index, topic if latency else ""))
        for index, topic in enumerate(topics)
    ]
    receiver = Receiver(node, heard, QoSProfile(depth=10))
    stop.wait()
    receiver.destroy()
    lines = [f"{topic} {count}" for topic, count in zip(topics, counts, strict=True)]
    lines += [f"! {tag} {arrived[stamp]!r}" for stamp, tag in tags.items() if stamp in arrived]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def stalling(node: Node, file: Path, stop: threading.Event, topics: list[str]) -> None:
    """Subscribe reliably and sleep over every message."""

    def sleep(message: Any) -> None:
        stop.wait(STALL)

    for topic in topics:
        name = topic.replace("~", "needle_sim")
        node.create_subscription(_type_of(topic), name, sleep, 10)
    _spin(node, stop)


def hostile(node: Node, file: Path, stop: threading.Event) -> None:
    """Send hostile messages from publishers that come and go; write how many."""
    rng, sent = random.Random(1), 0
    kinds = {"base_pose": PoseStamped, "stage_velocity": TwistStamped}
    while not stop.is_set():
        publishers = {name: node.create_publisher(kind, name, 10) for name, kind in kinds.items()}
        end = time.monotonic() + _HOSTILE_LIFE
        while time.monotonic() < end and not stop.wait(_HOSTILE_PAUSE):
            topic, data = hostile_message(rng)
            publishers[topic].publish(data)
            sent += 1
        for publisher in publishers.values():
            node.destroy_publisher(publisher)
    file.write_text(f"{sent}\n", encoding="utf-8")


def _doubles_at(data: bytes) -> int:
    """Return where the numbers of a stamped message begin, after its frame id."""
    (length,) = struct.unpack_from("<I", data, 12)
    end = 16 + length
    return int(end + (4 - end) % 8)


def _type_of(topic: str) -> Any:
    package, _, kind = _TYPES[topic].split("/")
    return getattr(import_module(f"{package}.msg"), kind)


def _spin(node: Node, stop: threading.Event) -> None:
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    while not stop.is_set():
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()


def main(arguments: list[str]) -> int:
    """Play a role until SIGTERM."""
    role, file, *topics = arguments
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f"soak_{role}")
    try:
        if role == "commander":
            commander(node, Path(file), stop)
        elif role == "hostile":
            hostile(node, Path(file), stop)
        elif role == "stalling":
            stalling(node, Path(file), stop, topics)
        else:
            subscribers(node, Path(file), stop, topics)
    finally:
        node.destroy_node()
        try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
