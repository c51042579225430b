# SPDX-License-Identifier: Apache-2.0
"""The bytes of what a tick shows and of what it was told, topic by topic or all at once.

The node publishes and records the same bytes; a run without ROS records them only. All at once
they are made by compiled code, where there is any, in half the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from needle_sim_ros import compiled
from needle_sim_ros.session import cdr, channels
from needle_sim_ros.session.channels import Channel

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation

try:
    from needle_sim_ros.session import _messages
except ImportError:  # built without a compiler, or run from the source
    _messages = None  # type: ignore[assignment]

_COMPILED = _messages is not None and compiled.wanted()

Encoder = Callable[[int, Any], bytes]


class Encoders:
    """Makes the messages of some topics, all of one subject.

    Parameters
    ----------
    each : mapping of Channel to callable
        What makes the bytes of a stamp, ns, and the subject.
    together : callable, optional
        Makes those of all topics, in this order.

    Attributes
    ----------
    each : tuple of (Channel, callable)
    together : callable
    """

    __slots__ = ("each", "together")

    def __init__(
        self,
        each: Mapping[Channel, Encoder],
        together: Callable[[int, Any], Sequence[bytes]] | None = None,
    ) -> None:
        self.each = tuple(each.items())
        self.together = together or self._in_turn

    def _in_turn(self, stamp: int, subject: Any) -> Sequence[bytes]:
        return [encode(stamp, subject) for _, encode in self.each]


def output_encoders(tissue_frame: str, base_frame: str) -> Encoders:
    """Return what makes the messages of `channels.OUTPUTS` of an observation."""
    vector = cdr.stamped_doubles(base_frame, 3)
    wrench = cdr.stamped_doubles(base_frame, 6)
    pose = cdr.stamped_doubles(tissue_frame, 7)
    cloud = cdr.marker_cloud(tissue_frame)
    each: dict[Channel, Callable[[int, Observation], bytes]] = {
        channels.TIP_DEFLECTION: lambda t, o: vector(t, o.readings.tip_deflection),
        channels.TIP_POSE: lambda t, o: pose(t, (*o.readings.tip_position, *tip_orientation(o))),
        channels.BASE_WRENCH: lambda t, o: wrench(
            t, o.readings.base_force + o.readings.base_torque
        ),
        channels.TISSUE_MARKERS: lambda t, o: cloud(t, o.marker_positions, o.marker_displacements),
        channels.INSERTION_DEPTH: lambda t, o: cdr.float64(o.insertion_depth),
        channels.PROCESS: lambda t, o: cdr.text(o.process.value),
        channels.STAGE_POSE: lambda t, o: pose(
            t, o.base_position.tolist() + o.base_orientation.tolist()
        ),
        channels.FRICTION_FORCE: lambda t, o: cdr.float64(o.friction_force),
        channels.TIP_FORCE: lambda t, o: cdr.float64(o.tip_force),
    }
    assert tuple(each) == channels.OUTPUTS
    return Encoders(each, _together(tissue_frame, base_frame) if _COMPILED else None)


def _together(
    tissue_frame: str, base_frame: str
) -> Callable[[int, Observation], tuple[bytes, ...]]:
    tissue, base = cdr.header(tissue_frame), cdr.header(base_frame)
    processes: dict[object, bytes] = {}
    clouds: dict[int, bytes] = {}

    def encode(stamp: int, observation: Observation) -> tuple[bytes, ...]:
        readings, process = observation.readings, observation.process
        markers = observation.markers
        if process not in processes:
            processes[process] = cdr.text(process.value)
        if len(markers) not in clouds:
            clouds[len(markers)] = cdr.blank_cloud(tissue_frame, len(markers))
        return _messages.outputs(
            stamp,
            cdr.ENCAPSULATION,
            tissue,
            base,
            readings,
            math.hypot(*readings.tip_slope),
            observation.base_position,
            observation.base_orientation,
            observation.insertion_depth,
            observation.tip_force,
            processes[process],
            clouds[len(markers)],
            markers,
            observation.marker_shifts,
        )

    return encode


def tip_orientation(observation: Observation) -> list[float]:
    """Return the quaternion x y z w of the tip: +z along the deflected needle there."""
    sx, sy = observation.readings.tip_slope
    x, y, z, w = observation.base_orientation.tolist()
    slope = math.hypot(sx, sy)
    if slope == 0.0:
        return [x, y, z, w]
    half = math.atan(slope) / 2
    c, s = math.cos(half), math.sin(half) / slope
    a, b = -s * sy, s * sx  # turns the base's +z towards (sx, sy, 1)
    return [
        w * a + x * c - z * b,
        w * b + y * c + z * a,
        x * b - y * a + z * c,
        w * c - x * a - y * b,
    ]


def motion_encoders(tissue_frame: str) -> dict[str, Encoders]:
    """Return, by kind of motion, where and how the motion of a tick is recorded."""
    pose = cdr.stamped_doubles(tissue_frame, 7)
    twist = cdr.stamped_doubles(tissue_frame, 6)
    return {
        "pose": Encoders({channels.APPLIED_POSE: lambda t, motion: pose(t, motion.values())}),
        "velocity": Encoders(
            {channels.APPLIED_VELOCITY: lambda t, motion: twist(t, motion.values())}
        ),
    }


EVENT_ENCODERS = Encoders(
    {channels.EVENTS: lambda stamp, event: channels.event_message(event[0], **event[1])}
)
TICK_TIME_ENCODERS = Encoders({channels.TICK_TIME: lambda stamp, took: cdr.float64(took)})
