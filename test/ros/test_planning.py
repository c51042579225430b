# SPDX-License-Identifier: Apache-2.0
"""Plans and predictions beside the running node, over real topics and services."""

import contextlib
import json
import pathlib
import signal
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseStamped  # noqa: E402
from nav_msgs.msg import Path  # noqa: E402
from nav_msgs.srv import GetPlan  # noqa: E402

DEEP = [0.0, 0.0, 0.130 - 0.020]  # of the base, the tip 20 mm deep


def posed(place, frame="tissue"):
    message = PoseStamped()
    message.header.frame_id = frame
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = map(float, place)
    q.x, q.w = 1.0, 0.0
    return message


def places(path):
    return np.array([[getattr(p.pose.position, axis) for axis in "xyz"] for p in path.poses])


def lead_to(cell, place, ticks=40):
    publisher = cell.publisher(PoseStamped, "base_pose")
    cell.send(publisher, posed(place))
    cell.step(ticks)
    assert cell.sim.plant.last_observation.base_position == pytest.approx(place, abs=1e-9)


def follow(cell, poses):
    publisher = cell.publisher(PoseStamped, "base_pose")
    for place in poses:
        cell.send(publisher, posed(place))
        for _ in range(200):
            cell.step()
            if np.allclose(cell.sim.plant.last_observation.base_position, place, atol=1e-9):
                break


def test_plan_from_the_running_state_reaches_the_target(cell):
    """From 20 mm deep; the simulator node itself then follows the answer to the target."""
    target = [0.001, 0.0, -0.034]
    scene = {**cell.scene_changes, "markers": [target]}
    overrides = "; ".join(f"{key}={json.dumps(value)}" for key, value in scene.items())
    cell.start(max_base_speed=0.05, scene_overrides=overrides)
    lead_to(cell, DEEP, 60)
    answer = cell.call(GetPlan, "/needle_sim/plan", goal=posed(target))
    way = places(answer.plan)
    assert answer.plan.header.frame_id == "tissue"
    assert way[0] == pytest.approx(DEEP, abs=1e-9)
    follow(cell, way[1:])
    seen = cell.sim.plant.last_observation
    assert np.linalg.norm(seen.tip_position - seen.marker_positions[0]) < 3e-4


def test_ticks_go_on_while_planning(cell):
    """The clock loop keeps its pace through a plan that takes many ticks' time."""
    cell.start(paused=False)
    client = cell.peer.create_client(GetPlan, "/needle_sim/plan")
    assert client.wait_for_service(30.0)
    ticks, began = cell.sim.plant.total_ticks, time.monotonic()
    future = client.call_async(GetPlan.Request(goal=posed((0.004, 0.0, -0.03))))
    cell.until(future.done, "plan")
    elapsed, gained = time.monotonic() - began, cell.sim.plant.total_ticks - ticks
    assert len(future.result().plan.poses) > 10
    assert elapsed > 20 * cell.sim.plant.period
    assert gained > 0.3 * elapsed / cell.sim.plant.period


@pytest.mark.parametrize(
    ("goal", "frame"), [((0.0, 0.0, 0.01), "tissue"), ((0.0, 0.0, -0.02), "elsewhere")]
)
def test_what_cannot_be_planned_gives_an_empty_way(cell, goal, frame):
    cell.start()
    answer = cell.call(GetPlan, "/needle_sim/plan", goal=posed(goal, frame))
    assert answer.plan.poses == []


def test_predicts_the_way_of_the_tip(cell):
    """The prediction agrees with what the node then does."""
    cell.start(max_base_speed=0.05)
    lead_to(cell, DEEP, 60)
    predictions = cell.collect(Path, "predicted_tip_path")
    candidate = Path()
    candidate.header.frame_id = "tissue"
    way = [np.add(DEEP, [0.0, 0.0, -1e-3 * k]) for k in range(1, 9)]
    candidate.poses = [posed(place) for place in way]
    publisher = cell.peer.create_publisher(Path, "candidate_base_path", 10)
    cell.until(publisher.get_subscription_count, "subscriber of candidate_base_path")
    publisher.publish(candidate)
    cell.until(lambda: predictions, "prediction")
    predicted = places(predictions[0])
    assert predicted.shape == (8, 3)
    follow(cell, way)
    seen = cell.sim.plant.last_observation
    assert predicted[-1] == pytest.approx(seen.tip_position, abs=2e-4)


def children(pid):
    """Return the processes that a process started and that still run."""
    found = []
    for folder in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            if int(parent) == pid and state != "Z":
                found.append(int(folder.name))
    return found


def test_a_killed_node_leaves_no_process_behind(cell, node_process):
    """Neither the one that plans, in the middle of it, nor the one that identifies."""
    node = node_process("identify:=true")
    node.until_running()
    client = cell.peer.create_client(GetPlan, "/needle_sim/plan")
    assert client.wait_for_service(30.0)
    before = set(children(node.process.pid))
    assert len(before) >= 2  # the estimator, and what keeps multiprocessing's resources
    client.call_async(GetPlan.Request(goal=posed((0.004, 0.0, -0.03))))
    cell.until(lambda: set(children(node.process.pid)) - before, "planning process")
    started = children(node.process.pid)
    node.end(signal.SIGKILL)
    cell.until(lambda: not any(pathlib.Path(f"/proc/{pid}").exists() for pid in started), "end")


SPATIAL = {
    "tissue.mesh.spacing_across": 3e-3,
    "tissue.mesh.spacing_along": 8e-3,
    "tissue.mesh.growth": 3.0,
    "solver.track_spacing": 8e-3,
    "markers": [],
}


def test_plans_for_a_scene_in_space(cell):
    """From above the surface: over the entry of the plan's choice and in; coarse."""
    overrides = "; ".join(f"{key}={json.dumps(value)}" for key, value in SPATIAL.items())
    cell.start(scene="bevel_gelatin_22g", scene_overrides=overrides)
    answer = cell.call(GetPlan, "/needle_sim/plan", goal=posed((0.004, -0.001, -0.04)))
    way = places(answer.plan)
    assert len(way) > 10
    assert way[-1][2] < way[0][2] - 0.035
    assert np.abs(way[-1][:2] - way[0][:2]).max() > 1e-4
