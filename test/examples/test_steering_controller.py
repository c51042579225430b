# SPDX-License-Identifier: Apache-2.0
"""The example controller, over real topics, against a plant 30 % beside its model."""

import importlib.util
import json
import threading
import time
from pathlib import Path

import pytest

from needle_sim_ros import Scene
from needle_sim_ros.planning.planner import Planner
from needle_sim_ros.planning.task import Task
from needle_sim_ros.planning.verify import verify

SOURCE = Path(__file__).parents[2] / "doc" / "examples" / "steering_controller.py"
TARGET = (0.004, 0.0, -0.045)
MODEL = {
    "solver.dynamics": "quasi_static",
    "solver.modes": 0,
    "solver.track_spacing": 2e-3,
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "markers": [list(TARGET)],
    "base.position": [0.0, 0.0, 0.132],
    "protocol": [{"duration": 5.2, "velocity": [0.0, 0.0, -10e-3]}],
}
MISMATCH = {
    "tissue.youngs_modulus": 1.3 * 15e3,
    "interaction.friction.static": 0.7 * 23.0,
    "interaction.friction.kinetic": 0.7 * 21.0,
    "needle.tip.deviation_angle": 1.3 * 0.02,
}


def as_parameter(changes):
    return "; ".join(f"{key}={json.dumps(value)}" for key, value in changes.items())


@pytest.fixture
def example(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    pytest.importorskip("rclpy")
    spec = importlib.util.spec_from_file_location("steering_controller", SOURCE)
    module = importlib.util.module_from_spec(spec)
    # dataclasses look their module up
    monkeypatch.setitem(__import__("sys").modules, "steering_controller", module)
    spec.loader.exec_module(module)
    return module


def open_loop_miss():
    """Return the miss of the plan made with the model, in the plant."""
    scene, task = Scene.load("gao2016", MODEL), Task(TARGET, ("entry",))
    plan = Planner.towards(scene, task).plan(task)
    assert plan.reachable
    return verify(plan.insertion.scene_of(scene).with_changes(MISMATCH)).miss


@pytest.mark.timeout(120)
def test_steers_to_the_target_against_another_plant(example, tmp_path, monkeypatch):
    """The final miss is at most a fifth of the open-loop plan's."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter

    from needle_sim_ros.ros.sim_node import SimNode

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    context = Context()
    rclpy.init(context=context, domain_id=101)
    plant_scene = as_parameter({**MODEL, **MISMATCH})
    settings = {"scene_overrides": plant_scene, "command_timeout": 0.0, "max_base_speed": 0.01}
    plant = SimNode(
        context=context, parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    settings = {"scene_overrides": as_parameter(MODEL), "marker": 1}
    controller = example.SteeringController(
        context=context, parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
    )
    executors, threads = [], []
    for node in (plant, controller):
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        executors.append(executor)
        threads.append(threading.Thread(target=executor.spin, daemon=True))
    for thread in threads:
        thread.start()
    plant.start()
    try:
        end = time.monotonic() + 100
        while not controller.law.done:
            assert time.monotonic() < end, f"not done, at {controller.seen}"
            assert all(thread.is_alive() for thread in threads)
            time.sleep(0.01)
        miss = controller.miss
    finally:
        plant.close()
        for executor, thread in zip(executors, threads, strict=True):
            executor.shutdown()
            thread.join()
        controller.destroy_node()
        plant.destroy_node()
        rclpy.try_shutdown(context=context)
    assert miss <= open_loop_miss() / 5
