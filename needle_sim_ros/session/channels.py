# SPDX-License-Identifier: Apache-2.0
"""What a session holds: every topic, its type, and its bytes from an observation.

The node publishes and records the same bytes; a run without ROS records them only.
Names starting with `~/` are private to the node.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from needle_sim_ros.session import cdr
from needle_sim_ros.session.motion import Motion

if TYPE_CHECKING:
    from needle_sim_ros.observation import Observation

Encoder = Callable[[int, "Observation"], bytes]


@dataclass(frozen=True, eq=False)
class Channel:
    """A topic by its role in a session, its name as written in the node, and its type."""

    role: str
    name: str
    type: str


BASE_POSE = Channel("base_pose", "base_pose", "geometry_msgs/msg/PoseStamped")
STAGE_VELOCITY = Channel("stage_velocity", "stage_velocity", "geometry_msgs/msg/TwistStamped")
APPLIED_POSE = Channel("applied_pose", "~/applied_pose", "geometry_msgs/msg/PoseStamped")
APPLIED_VELOCITY = Channel(
    "applied_velocity", "~/applied_velocity", "geometry_msgs/msg/TwistStamped"
)
EVENTS = Channel("events", "~/events", "std_msgs/msg/String")
CLOCK = Channel("clock", "/clock", "rosgraph_msgs/msg/Clock")
DIAGNOSTICS = Channel("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")

TIP_DEFLECTION = Channel("tip_deflection", "tip_deflection", "geometry_msgs/msg/Vector3Stamped")
TIP_POSE = Channel("tip_pose", "tip_pose", "geometry_msgs/msg/PoseStamped")
BASE_WRENCH = Channel("base_wrench", "base_wrench", "geometry_msgs/msg/WrenchStamped")
TISSUE_MARKERS = Channel("tissue_markers", "tissue_markers", "sensor_msgs/msg/PointCloud2")
INSERTION_DEPTH = Channel("insertion_depth", "insertion_depth", "std_msgs/msg/Float64")
PROCESS = Channel("process", "process", "std_msgs/msg/String")
STAGE_POSE = Channel("stage_pose", "~/stage_pose", "geometry_msgs/msg/PoseStamped")
FRICTION_FORCE = Channel("friction_force", "~/friction_force", "std_msgs/msg/Float64")
TIP_FORCE = Channel("tip_force", "~/tip_force", "std_msgs/msg/Float64")
TICK_TIME = Channel("tick_time", "~/tick_time", "std_msgs/msg/Float64")  # wall clock, s

INPUTS = (BASE_POSE, STAGE_VELOCITY)
RECORDS = (APPLIED_POSE, APPLIED_VELOCITY, EVENTS, TICK_TIME, DIAGNOSTICS)
OUTPUTS = (
    TIP_DEFLECTION,
    TIP_POSE,
    BASE_WRENCH,
    TISSUE_MARKERS,
    INSERTION_DEPTH,
    PROCESS,
    STAGE_POSE,
    FRICTION_FORCE,
    TIP_FORCE,
)


def resolve(name: str, namespace: str = "/", node: str = "needle_sim") -> str:
    """Return the full name of a topic, without remappings."""
    if name.startswith("/"):
        return name
    root = namespace.rstrip("/")
    return f"{root}/{node}{name[1:]}" if name.startswith("~/") else f"{root}/{name}"


def output_encoders(tissue_frame: str, base_frame: str) -> dict[Channel, Encoder]:
    """Return, for every output, what makes its bytes of a stamp (ns) and an observation."""
    vector = cdr.stamped_doubles(base_frame, 3)
    wrench = cdr.stamped_doubles(base_frame, 6)
    pose = cdr.stamped_doubles(tissue_frame, 7)
    cloud = cdr.marker_cloud(tissue_frame)
    processes: dict[str, bytes] = {}

    def process(stamp: int, observation: Observation) -> bytes:
        name = observation.process.value
        if name not in processes:
            processes[name] = cdr.text(name)
        return processes[name]

    return {
        TIP_DEFLECTION: lambda t, o: vector(t, o.readings.tip_deflection),
        TIP_POSE: lambda t, o: pose(t, (*o.readings.tip_position, *tip_orientation(o))),
        BASE_WRENCH: lambda t, o: wrench(t, o.readings.base_force + o.readings.base_torque),
        TISSUE_MARKERS: lambda t, o: cloud(t, o.marker_positions, o.marker_displacements),
        INSERTION_DEPTH: lambda t, o: cdr.float64(o.insertion_depth),
        PROCESS: process,
        STAGE_POSE: lambda t, o: pose(t, o.base_position.tolist() + o.base_orientation.tolist()),
        FRICTION_FORCE: lambda t, o: cdr.float64(o.friction_force),
        TIP_FORCE: lambda t, o: cdr.float64(o.tip_force),
    }


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


def motion_encoders(
    tissue_frame: str,
) -> dict[str, tuple[Channel, Callable[[int, Motion], bytes]]]:
    """Return, by kind of motion, where and how the motion of a tick is recorded."""
    pose = cdr.stamped_doubles(tissue_frame, 7)
    twist = cdr.stamped_doubles(tissue_frame, 6)
    return {
        "pose": (APPLIED_POSE, lambda t, motion: pose(t, motion.values())),
        "velocity": (APPLIED_VELOCITY, lambda t, motion: twist(t, motion.values())),
    }


INTERACTION_EVENT = "interaction"  # its detail `changes` maps keys to values


def event_message(event: str, **details: object) -> bytes:
    """Return the bytes of an event: JSON with its name and details."""
    return cdr.text(json.dumps({"event": event, **details}))
