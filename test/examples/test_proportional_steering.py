# SPDX-License-Identifier: Apache-2.0
"""The short example controller, over real topics: it steers, where going straight misses."""

import importlib.util
import json
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

SOURCE = Path(__file__).parents[2] / "doc" / "examples" / "proportional_steering.py"
SCENE = {
    "solver.dynamics": "quasi_static",
    "solver.track_spacing": 2e-3,
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "base.position": [0.0, 0.0, 0.131],
    "markers": [[0.005, 0.0, -0.045]],
}


@pytest.fixture
def example():
    spec = importlib.util.spec_from_file_location("proportional_steering", SOURCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("gain", "worst", "least"), [(8.0, 0.6e-3, 0.0), (0.0, 6e-3, 3e-3)])
def test_it_reaches_the_target_and_only_by_steering(example, monkeypatch, gain, worst, least):
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter

    from needle_sim_ros.ros.sim_node import SimNode

    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(example, "GAIN", gain)
    context = Context()
    rclpy.init(context=context, domain_id=130 + int(gain))
    overrides = "; ".join(f"{key}={json.dumps(value)}" for key, value in SCENE.items())
    sim = SimNode(
        context=context,
        parameter_overrides=[
            Parameter("scene_overrides", value=overrides),
            Parameter("rate", value=50.0),
        ],
    )
    controller = example.ProportionalSteering(
        context=context, parameter_overrides=[Parameter("speed", value=0.02)]
    )
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(sim)
    executor.add_node(controller)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    sim.start()
    try:
        deadline = time.monotonic() + 60
        while controller.miss is None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert controller.miss is not None, "the tip never came to the target's depth"
        assert least <= controller.miss <= worst
    finally:
        sim.close()
        executor.shutdown()
        thread.join()
        controller.destroy_node()
        sim.destroy_node()
        rclpy.try_shutdown(context=context)
