# SPDX-License-Identifier: Apache-2.0
"""What a session holds: every topic and its type.

Names starting with `~/` are private to the node.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from needle_sim_ros.session import cdr


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


INTERACTION_EVENT = "interaction"  # its detail `changes` maps keys to values


def event_message(event: str, **details: object) -> bytes:
    """Return the bytes of an event: JSON with its name and details."""
    return cdr.text(json.dumps({"event": event, **details}))
