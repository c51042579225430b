# SPDX-License-Identifier: Apache-2.0
"""A model-predictive controller as a node of its own: it steers the tip to a target.

It plans the insertion with its own model, leads the base along the first part of the plan,
compares what it sees with what the model says, and plans the rest again, until the tip is at
the target. The plant may be another than the model: another modulus, friction, bevel.

    needle_sim plan ...                     # open loop, for comparison
    ros2 run needle_sim_ros sim_node --ros-args -p scene:=gao2016 -p command_timeout:=0.0
    python3 doc/examples/steering_controller.py --ros-args -p scene:=gao2016 -p marker:=3

Subscribes to tip_pose, tip_deflection and tissue_markers; publishes base_pose.
"""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from needle_sim_ros import Scene
from needle_sim_ros.geometry import rotation_matrix
from needle_sim_ros.planning.continuation import Continuation, Pose, Way, follow, steer
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.planner import Planner
from needle_sim_ros.planning.task import Task

Vector = NDArray[np.float64]

# as far as this the first plan is followed before anything is compared, m
FIRST = 2e-3
# an end within this is the end, m
ENOUGH = 5e-5
# looks back for the trend of what the model does not know
TREND = 4
# a base within this of where it was sent has arrived, m
ARRIVED = 1e-6


@dataclass(frozen=True)
class Seen:
    """What one tick of the plant shows: time s; base, tip and target, m."""

    time: float
    base: Vector
    tip: Vector
    target: Vector


class SteeringLaw:
    """Decides where the base goes next; knows nothing of ROS.

    Parameters
    ----------
    scene : Scene
        The model.
    target : tuple of 3 floats
        Reference position, m.
    replan : float
        Travel of the base between plans, m.
    """

    def __init__(self, scene: Scene, target: tuple[float, float, float], replan: float) -> None:
        task = Task(target, ("entry",))
        planner = Planner.towards(scene, task)
        self.plan: Insertion = planner.plan(task).insertion
        self.done = False
        self.speed = self.plan.speed
        self._model, self._replan = planner.simulator, replan
        self._point = self._model.material_point(target)
        self._orientation = tuple(self.plan.facing(0.0).tolist())
        self._way: Way | None = None
        self._followed = 0.0
        self._offset = (0.0, 0.0)
        self._unknown: list[tuple[float, Vector]] = []
        self._stage = 0

    def look(self, seen: Seen) -> None:
        """Note a tick: the model has to go the way that the base really goes."""
        here = Pose(seen.time, tuple(seen.base.tolist()), self._orientation)
        if self._way is None:
            self._model.reset()
            follow(self._model, [here])
            spacing = self._model.scene.solver.track_spacing / 4
            self._way, self._followed = Way(here, spacing), seen.time
        self._way.add(here)

    def next_places(self, seen: Seen) -> list[Vector]:
        """Return where the base has to go next, one place after the other; none at the end."""
        self._stage += 1
        if self._stage == 1:  # beside the tissue, over the entry, and in
            return [self.plan.place(-1e-3), self.plan.place(FIRST)]
        self._follow()
        bias = self._bias(seen)
        found, _ = steer(self._model, self._point, self.speed, bias, self._offset)
        if abs(found.travel) < ENOUGH:
            self.done = True
            return []
        return [self._part_of(found)]

    def _follow(self) -> None:
        """Lead the model along the way of the base since the last time."""
        assert self._way is not None
        poses = [pose for pose in self._way.poses if pose.time > self._followed]
        if poses:
            begin = Pose(self._followed, poses[0].position, poses[0].orientation)
            follow(self._model, [begin, *poses])
            self._followed = poses[-1].time

    def _bias(self, seen: Seen) -> Vector:
        """Return by how much the tip will be farther from the target than the model says.

        The difference seen so far goes on to grow as it did.
        """
        modelled = self._model.observe().tip_position - self._model.position_of(self._point)
        difference = (seen.tip - seen.target) - modelled
        depth = self._model.inserted
        self._unknown.append((depth, difference))
        recent = self._unknown[-TREND:]
        spread = recent[-1][0] - recent[0][0]
        if len(recent) < 3 or spread < FIRST:
            return difference
        depths = np.array([d for d, _ in recent])
        slope = np.polyfit(depths - depths.mean(), np.array([b for _, b in recent]), 1)[0]
        left = float((seen.target - seen.tip) @ self.plan.axis)
        return np.asarray(difference + max(left, 0.0) * slope)

    def _part_of(self, found: Continuation) -> Vector:
        """Return the place at the end of the part of a plan that is carried out."""
        part = min(found.travel, self._replan)
        share = min(max(part, 0.0) / found.reference, 1.0)
        self._offset = (found.offset[0] * (1 - share), found.offset[1] * (1 - share))
        return found.place(part)


class SteeringController(Node):
    """The node around the law."""

    def __init__(self, **options: object) -> None:
        super().__init__("steering_controller", **options)  # type: ignore[arg-type]
        name = self.declare_parameter("scene", "gao2016").value
        changes = self.declare_parameter("scene_overrides", "").value
        self._marker = int(self.declare_parameter("marker", 3).value) - 1
        replan = float(self.declare_parameter("replan", 4e-3).value)
        self._frame = str(self.declare_parameter("tissue_frame", "tissue").value)
        self._scene = Scene.load(name, _overrides(changes))
        x, y, z = self._scene.markers[self._marker]
        self.law = SteeringLaw(self._scene, (x, y, z), replan)
        self._places: list[Vector] = []
        self._latest: dict[str, tuple[int, Vector]] = {}
        self._sent: Vector | None = None
        self.seen: Seen | None = None
        self._command = self.create_publisher(PoseStamped, "base_pose", 10)
        self.create_subscription(PoseStamped, "tip_pose", self._take_tip, 10)
        self.create_subscription(Vector3Stamped, "tip_deflection", self._take_deflection, 10)
        self.create_subscription(PointCloud2, "tissue_markers", self._take_markers, 10)

    def _take_tip(self, message: PoseStamped) -> None:
        p = message.pose.position
        self._take("tip", message.header.stamp, np.array([p.x, p.y, p.z]))

    def _take_deflection(self, message: Vector3Stamped) -> None:
        v = message.vector
        self._take("deflection", message.header.stamp, np.array([v.x, v.y, v.z]))

    def _take_markers(self, message: PointCloud2) -> None:
        start = self._marker * message.point_step
        place = np.frombuffer(bytes(message.data), dtype="<f4", count=3, offset=start)
        self._take("target", message.header.stamp, place.astype(float))

    def _take(self, name: str, stamp: object, value: Vector) -> None:
        """Act once all of a tick is there."""
        time = stamp.sec * 10**9 + stamp.nanosec  # type: ignore[attr-defined]
        self._latest[name] = (time, value)
        if len(self._latest) == 3 and len({t for t, _ in self._latest.values()}) == 1:
            self._tick(1e-9 * time)

    def _tick(self, time: float) -> None:
        tip, target = self._latest["tip"][1], self._latest["target"][1]
        turned = rotation_matrix(self.law.plan.facing(0.0))
        straight = tip - turned @ self._latest["deflection"][1]
        base = straight - self._scene.needle.length * turned[:, 2]
        self.seen = seen = Seen(time, base, tip, target)
        if self.law.done:
            return
        self.law.look(seen)
        if self._sent is not None and np.linalg.norm(base - self._sent) > ARRIVED:
            self._send(self._sent)  # subscriptions are best effort: say it again
            return
        if not self._places:
            self._places = self.law.next_places(seen)
            if not self._places:
                self.get_logger().info(f"done, {1e3 * self.miss:.3f} mm from the target")
                return
        self._send(self._places.pop(0))

    @property
    def miss(self) -> float:
        """Distance of tip and target as last seen, m."""
        assert self.seen is not None
        return float(np.linalg.norm(self.seen.tip - self.seen.target))

    def _send(self, place: Vector) -> None:
        self._sent = place
        message = PoseStamped()
        message.header.frame_id = self._frame
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = place.tolist()
        q.x, q.y, q.z, q.w = self.law.plan.facing(0.0).tolist()
        self._command.publish(message)


def _overrides(text: str) -> dict[str, object]:
    from needle_sim_ros.commands.options import parse_overrides

    return parse_overrides([part for part in text.split(";") if part.strip()])


def main() -> int:
    """Run the controller until it is stopped."""
    rclpy.init()
    node = SteeringController()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
