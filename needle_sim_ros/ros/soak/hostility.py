# SPDX-License-Identifier: Apache-2.0
"""Hostile messages to a node that is stepped beside a simulator of our own."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from geometry_msgs.msg import PoseStamped, WrenchStamped

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.node_process import NodeProcess
from needle_sim_ros.ros.soak.hostile import hostile_message
from needle_sim_ros.ros.soak.watch import Watch
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.encoding import output_encoders
from needle_sim_ros.session.writer import BASE_FRAME, TISSUE_FRAME
from needle_sim_ros.simulator import Simulator

_BATCH = 8  # fewer than the subscription's queue holds
_PATIENCE = 0.5  # s to wait for a batch; the subscription is best effort
_ANSWER = 20.0  # s
_TURN = 60  # steps until the needle turns round
_DOWN = 0.018  # m that it goes down first: into the tissue
_SPEED = 3e-3  # m/s, then
_STAMP = struct.Struct("<iI")


@dataclass(frozen=True)
class Hostility:
    """Messages that arrived, steps made, and steps that came out otherwise than undisturbed."""

    messages: int
    steps: int
    changed: int


def provoke(
    scene: Scene,
    parameters: dict[str, object],
    domain: int,
    log: Path,
    count: int,
    advance: Callable[[int], object],
) -> Hostility:
    """Send hostile messages between the steps of a moving needle; compare every step's bits.

    Parameters
    ----------
    scene : Scene
        What the node simulates.
    parameters : dict
        Of the node.
    domain : int
        ROS domain id.
    log : Path
        Of the node.
    count : int
        Messages that the node must have received.
    advance : callable
        Told of how many more it has received.
    """
    simulator = Simulator(scene)
    period = 1.0 / float(str(parameters["rate"]))
    encoders = dict(output_encoders(TISSUE_FRAME, BASE_FRAME).each)
    heard: dict[str, dict[int, bytes]] = {"base_wrench": {}, "tip_pose": {}}
    rng = random.Random(0)
    received = steps = changed = 0
    given = {**parameters, "command_timeout": 0.0, "max_base_speed": 1.0}
    with (
        NodeProcess(given, domain, log) as node,
        Watch(domain, node.check) as watch,
    ):
        for name, kind in (("base_wrench", WrenchStamped), ("tip_pose", PoseStamped)):
            watch.listen(kind, name, _keeper(heard[name]))
        watch.wait_ready()
        watch.pause(True)
        watch.reset()
        while received < count or steps < 2 * _TURN:
            up = (steps // _TURN) % 2 == 1
            speed = -_DOWN / (_TURN * period) if steps < _TURN else _SPEED if up else -_SPEED
            command = BaseCommand(velocity=[0.0, 0.0, speed], angular_velocity=[0.0, 0.0, 0.0])
            if steps % _TURN == 0:
                watch.deliver(command)
            before = int(watch.pause(True)["commands_received"])
            for _ in range(_BATCH):
                topic, data = hostile_message(rng)
                watch.publishers[topic].publish(data)
            arrived = 0

            def all_there(before: int = before) -> bool:
                nonlocal arrived
                arrived = int(watch.pause(True)["commands_received"]) - before
                return arrived >= _BATCH

            watch.until(all_there, _PATIENCE)
            advance(max(0, min(arrived, count - received)))
            received += arrived
            watch.step()
            steps += 1
            observation = simulator.step(command, period)
            stamp = round(observation.time * 1e9)
            if not watch.until(partial(_have, heard, stamp), _ANSWER):
                raise NeedleSimError("the node does not publish what it steps")
            expected = {c.name: encode(stamp, observation) for c, encode in encoders.items()}
            changed += any(h.pop(stamp) != expected[name] for name, h in heard.items())
    return Hostility(received, steps, changed)


def _have(heard: dict[str, dict[int, bytes]], stamp: int) -> bool:
    return all(stamp in messages for messages in heard.values())


def _keeper(messages: dict[int, bytes]) -> Callable[[bytes], None]:
    def keep(data: bytes) -> None:
        second, nanosecond = _STAMP.unpack_from(data, 4)
        messages[second * 10**9 + nanosecond] = bytes(data)

    return keep
