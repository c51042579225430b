# SPDX-License-Identifier: Apache-2.0
"""Planning beside the running node: the service `~/plan` and predictions of the tip's way.

They live on a node of their own, spun by a thread of its own, which waits for a process
that plans: neither the ticks nor the topics of the simulator node ever wait for them.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.planning.continuation import Pose, Way
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.process import (
    PlanningProcess,
    PlanRequest,
    PredictRequest,
    Running,
)
from needle_sim_ros.ros.plant import Plant
from needle_sim_ros.ros.spinning import Spinning

# how often the base is looked at, s; and how dense the way kept is, in track spacings
_LOOK, _KEPT = 0.05, 0.5
# way of a candidate at most
_MOST_POSES = 10_000
_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class Planning:
    """The planning interface of a simulator node.

    Parameters
    ----------
    node : Node
        The simulator node: names are resolved as its own.
    plant : Plant
        What is planned for.
    tissue_frame : str
        Frame of all poses.
    """

    def __init__(self, node: Node, plant: Plant, tissue_frame: str) -> None:
        self._plant, self._frame = plant, tissue_frame
        self._speed = Insertion.of(plant.scene).speed
        self._process = PlanningProcess(plant.scene)
        self._lock = threading.Lock()
        self._way = self._begun()
        self._closed = False
        self._node = rclpy.create_node(
            f"{node.get_name()}_planning",
            namespace=node.get_namespace(),
            context=node.context,
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._node.create_service(GetPlan, node.resolve_service_name("~/plan"), self._plan)
        self._predicted = self._node.create_publisher(
            Path, node.resolve_topic_name("predicted_tip_path"), _RELIABLE
        )
        self._node.create_subscription(
            Path, node.resolve_topic_name("candidate_base_path"), self._predict, 1
        )
        self._spinning = Spinning(self._node, "planning")
        self._looking = threading.Event()
        self._watch = threading.Thread(target=self._look_on, name="base path", daemon=True)
        self._watch.start()

    def close(self) -> None:
        """End process, threads and node; the context must still be valid."""
        if self._closed:
            return
        self._closed = True
        self._looking.set()
        self._watch.join()
        self._process.close()
        self._spinning.stop()
        self._node.destroy_node()

    def _look_on(self) -> None:
        while not self._looking.wait(_LOOK):
            self._look()

    def _look(self) -> Way:
        """Note where the base is."""
        seen = self._plant.last_observation
        with self._lock:
            if seen is None or seen.time < self._way.latest.time:
                self._way = self._begun()
            if seen is not None:
                position, facing = seen.base_position.tolist(), seen.base_orientation.tolist()
                self._way.add(Pose(seen.time, tuple(position), tuple(facing)))
            return self._way

    def _begun(self) -> Way:
        base = self._plant.scene.base
        assert base.position is not None
        start = Pose(0.0, tuple(base.position), tuple(base.orientation))
        return Way(start, _KEPT * self._plant.scene.solver.track_spacing)

    def _running(self) -> Running:
        way = self._look()
        with self._lock:
            return Running(way.poses, self._plant.current_scene.interaction)

    def _plan(self, request: Any, response: Any) -> Any:
        """Answer with a way of the base; with an empty one and a warning where there is none."""
        response.plan.header.frame_id = self._frame
        goal = request.goal
        try:
            self._check_frame(goal.header.frame_id)
            p = goal.pose.position
            asked = PlanRequest(self._running(), (p.x, p.y, p.z), self._speed)
            answer = self._process.ask(asked)
        except NeedleSimError as error:
            self._warn(f"no plan: {error}")
            return response
        start = self._plant.time
        response.plan.header.stamp = _stamp(start)
        response.plan.poses = [
            self._stamped(pose.position, pose.orientation, start + pose.time)
            for pose in answer.poses
        ]
        self._node.get_logger().info(f"planned, miss {1e3 * answer.miss:.3f} mm")
        return response

    def _predict(self, message: Any) -> None:
        """Publish where the tip would go; only when somebody listens."""
        if not self._predicted.get_subscription_count():
            return
        try:
            self._check_frame(message.header.frame_id)
            running = self._running()
            poses = _read(message, running.poses[-1].time)
            tips = self._process.ask(PredictRequest(running, poses))
        except NeedleSimError as error:
            self._warn(f"no prediction: {error}")
            return
        path = Path()
        path.header.frame_id = self._frame
        path.header.stamp = message.header.stamp
        path.poses = [
            self._stamped(tip, pose.orientation, pose.time)
            for tip, pose in zip(tips.tolist(), poses, strict=True)
        ]
        if not self._closed:
            self._predicted.publish(path)

    def _check_frame(self, frame: str) -> None:
        if frame not in ("", self._frame):
            raise NeedleSimError(f"frame {frame!r}: must be {self._frame!r}")

    def _warn(self, text: str) -> None:
        if not self._closed:
            self._node.get_logger().warning(text)

    def _stamped(
        self, position: Sequence[float], orientation: Sequence[float], time: float
    ) -> PoseStamped:
        message = PoseStamped()
        message.header.frame_id = self._frame
        message.header.stamp = _stamp(time)
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = map(float, position)
        q.x, q.y, q.z, q.w = map(float, orientation)
        return message


def _stamp(time: float) -> Any:
    from builtin_interfaces.msg import Time

    nanoseconds = round(time * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def _read(message: Any, now: float) -> tuple[Pose, ...]:
    """Return the poses of a candidate, timed by their stamps where these rise.

    Raises
    ------
    NeedleSimError
        On an empty way, one too long, or numbers that are not finite.
    """
    if not 1 <= len(message.poses) <= _MOST_POSES:
        raise NeedleSimError(f"{len(message.poses)} poses: must be 1 to {_MOST_POSES}")
    poses, time = [], now
    for stamped in message.poses:
        p, q = stamped.pose.position, stamped.pose.orientation
        numbers = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
        if not np.isfinite(numbers).all():
            raise NeedleSimError("a pose is not finite")
        stamp = stamped.header.stamp.sec + 1e-9 * stamped.header.stamp.nanosec
        time = max(time, stamp)
        poses.append(Pose(time, tuple(numbers[:3].tolist()), tuple(numbers[3:].tolist())))
    return tuple(poses)
