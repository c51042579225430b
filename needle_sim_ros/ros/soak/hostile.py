# SPDX-License-Identifier: Apache-2.0
"""Messages that the node has to ignore, made at random."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.serialization import serialize_message

_BAD = (math.nan, math.inf, -math.inf)
_FRAMES = ("map", "world", "needle_base", "Tissue", "tissue ", "/tissue", "\N{SNOWMAN}" * 50)
_FAR = 10.0  # m

Hostile = tuple[str, bytes]  # topic, serialised message


def hostile_message(rng: random.Random) -> Hostile:
    """Return topic and bytes of a message that must change nothing.

    Parameters
    ----------
    rng : random.Random
        Where the chances come from.
    """
    return rng.choice(_KINDS)(rng)


def _pose(rng: random.Random) -> PoseStamped:
    message = PoseStamped()
    message.header.stamp.sec = rng.choice((0, 1, -(2**31), 2**31 - 1, rng.randrange(2**31)))
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = rng.uniform(-0.01, 0.01), 0.0, rng.uniform(0.1, 0.14)
    q.x, q.w = 1.0, 0.0
    return message


def _twist(rng: random.Random) -> TwistStamped:
    message = TwistStamped()
    message.header.stamp.sec = rng.randrange(2**31)
    message.twist.linear.z = rng.choice((rng.uniform(-1, 1), 1e300, -1e300, 5e-324))
    return message


def _spoil(rng: random.Random, parts: list[Any]) -> None:
    part = rng.choice(parts)
    setattr(part, rng.choice([n for n in ("x", "y", "z", "w") if hasattr(part, n)]), _number(rng))


def _number(rng: random.Random) -> float:
    return rng.choice(_BAD)


def _not_finite_pose(rng: random.Random) -> Hostile:
    message = _pose(rng)
    _spoil(rng, [message.pose.position, message.pose.orientation])
    return "base_pose", bytes(serialize_message(message))


def _not_finite_twist(rng: random.Random) -> Hostile:
    message = _twist(rng)
    _spoil(rng, [message.twist.linear, message.twist.angular])
    return "stage_velocity", bytes(serialize_message(message))


def _wrong_frame(rng: random.Random) -> Hostile:
    topic, message = rng.choice((("base_pose", _pose(rng)), ("stage_velocity", _twist(rng))))
    message.header.frame_id = rng.choice(_FRAMES)
    return topic, bytes(serialize_message(message))


def _zero_quaternion(rng: random.Random) -> Hostile:
    message = _pose(rng)
    message.pose.orientation.x = rng.choice((0.0, -0.0, 1e-9, 5e-324))
    return "base_pose", bytes(serialize_message(message))


def _far(rng: random.Random) -> Hostile:
    message = _pose(rng)
    message.pose.position.z = rng.choice((-1, 1)) * rng.choice((_FAR, 1e6, 1e300))
    return "base_pose", bytes(serialize_message(message))


def _cut(rng: random.Random) -> Hostile:
    topic, message = rng.choice((("base_pose", _pose(rng)), ("stage_velocity", _twist(rng))))
    data = bytes(serialize_message(message))
    return topic, data[: rng.randrange(len(data) - 9)]  # the last may be padding


def _noise(rng: random.Random) -> Hostile:
    # No representation of data starts with these bytes, so it is no message by chance.
    data = b"\xff\xff" + rng.randbytes(rng.choice((0, 1, 2, 60, 5000)))
    return rng.choice(("base_pose", "stage_velocity")), data


_KINDS: tuple[Callable[[random.Random], Hostile], ...] = (
    _not_finite_pose,
    _not_finite_twist,
    _wrong_frame,
    _zero_quaternion,
    _far,
    _cut,
    _noise,
)
