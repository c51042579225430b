# SPDX-License-Identifier: Apache-2.0
"""The node over real topics: what it publishes, how it steps, what it refuses."""

import json
import math

import numpy as np
import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped, WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.interaction import compiled_balance
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

OUTPUTS = {
    "/tip_deflection": Vector3Stamped,
    "/tip_pose": PoseStamped,
    "/base_wrench": WrenchStamped,
    "/tissue_markers": PointCloud2,
    "/insertion_depth": Float64,
    "/process": String,
    "/needle_sim/stage_pose": PoseStamped,
    "/needle_sim/friction_force": Float64,
    "/needle_sim/tip_force": Float64,
}
DT = 0.01


def velocity(z, frame="tissue", x=0.0):
    message = TwistStamped()
    message.header.frame_id = frame
    message.twist.linear.x, message.twist.linear.z = float(x), float(z)
    return message


def pose(position, orientation=(1.0, 0.0, 0.0, 0.0), frame="tissue"):
    message = PoseStamped()
    message.header.frame_id = frame
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = map(float, position)
    q.x, q.y, q.z, q.w = map(float, orientation)
    return message


def xyz(v):
    return [v.x, v.y, v.z]


def simulated(cell, commands, dt=DT):
    """Return the observations of a simulator of the test's own."""
    simulator = Simulator(Scene.load("gao2016", cell.scene_changes))
    return [simulator.step(command, dt) for command in commands]


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def test_topics_and_services_are_those_promised(cell):
    sim = cell.start()
    expected = {
        topic: f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        for topic, kind in OUTPUTS.items()
    }
    expected["/diagnostics"] = "diagnostic_msgs/msg/DiagnosticArray"
    for topic, kind in expected.items():
        (info,) = cell.until(lambda topic=topic: cell.peer.get_publishers_info_by_topic(topic))
        assert info.topic_type == kind
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        assert info.qos_profile.durability == DurabilityPolicy.VOLATILE
    for topic in ("/base_pose", "/stage_velocity"):
        (info,) = cell.until(lambda topic=topic: cell.peer.get_subscriptions_info_by_topic(topic))
        assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    services = dict(sim.get_service_names_and_types())
    for name in ("reset", "step"):
        assert services[f"/needle_sim/{name}"] == ["std_srvs/srv/Trigger"]
    for name in ("pause", "record"):
        assert services[f"/needle_sim/{name}"] == ["std_srvs/srv/SetBool"]


def test_every_step_publishes_what_the_simulator_says_to_the_bit(cell):
    cell.start()
    received = {topic: cell.collect(kind, topic) for topic, kind in OUTPUTS.items()}
    publisher = cell.publisher(TwistStamped, "/stage_velocity")
    commands = []
    for z, ticks in ((-0.05, 20), (0.0, 3), (0.05, 3)):
        cell.send(publisher, velocity(z))
        status = cell.step(ticks)
        command = BaseCommand(velocity=[0, 0, z], angular_velocity=[0, 0, 0])
        commands += [command] * ticks
    observations = simulated(cell, commands)
    n = len(observations)
    assert status == {
        "time": observations[-1].time,
        "ticks": n,
        "commands_received": 3,
        "commands_rejected": 0,
        "paused": True,
    }
    for topic, messages in received.items():
        cell.until(lambda messages=messages: len(messages) >= n, topic)
    stamps = [round(o.time * 1e9) for o in observations]
    for topic in ("/tip_deflection", "/tip_pose", "/base_wrench", "/tissue_markers"):
        assert [nanoseconds(m.header.stamp) for m in received[topic]] == stamps, topic
    for k, o in enumerate(observations):
        wrench = received["/base_wrench"][k]
        assert wrench.header.frame_id == "needle_base"
        assert xyz(wrench.wrench.force) == o.base_force.tolist()
        assert xyz(wrench.wrench.torque) == o.base_torque.tolist()
        assert xyz(received["/tip_deflection"][k].vector) == o.tip_deflection.tolist()
        tip = received["/tip_pose"][k]
        assert tip.header.frame_id == "tissue"
        assert xyz(tip.pose.position) == o.tip_position.tolist()
        stage = received["/needle_sim/stage_pose"][k]
        assert xyz(stage.pose.position) == o.base_position.tolist()
        assert received["/insertion_depth"][k].data == o.insertion_depth
        assert received["/process"][k].data == o.process.value
        assert received["/needle_sim/friction_force"][k].data == o.friction_force
        assert received["/needle_sim/tip_force"][k].data == o.tip_force
        cloud = np.frombuffer(bytes(received["/tissue_markers"][k].data), "<f4").reshape(-1, 7)
        np.testing.assert_array_equal(cloud[:, :3], o.marker_positions.astype(np.float32))
        np.testing.assert_array_equal(cloud[:, 3:6], o.marker_displacements.astype(np.float32))
    assert {o.process.value for o in observations} >= {"contact", "insertion", "hold", "retraction"}
    assert all(len(messages) == n for messages in received.values())


def test_the_tip_pose_points_along_the_deflected_needle(cell):
    bent = {"needle.tip.deviation_angle": 0.3, "needle.youngs_modulus": 1e8}
    changes = {**cell.scene_changes, **bent}
    cell.start(scene_overrides="; ".join(f"{k}={json.dumps(v)}" for k, v in changes.items()))
    tips = cell.collect(PoseStamped, "/tip_pose")
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-0.05))
    cell.step(40)
    cell.until(lambda: len(tips) == 40)
    q = tips[-1].pose.orientation
    x, y, z, w = q.x, q.y, q.z, q.w
    axis = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]
    last = cell.sim.plant.last_observation
    tangent = last.needle_points[-1] - last.needle_points[-2]
    np.testing.assert_allclose(axis, tangent / np.linalg.norm(tangent), atol=2e-3)
    assert abs(axis[0]) > 5e-3


HOSTILE = {
    "not a number": ("/base_pose", pose((0, 0, math.nan))),
    "infinite": ("/stage_velocity", velocity(-math.inf)),
    "zero quaternion": ("/base_pose", pose((0, 0, 0.13), (0, 0, 0, 0))),
    "pose in a wrong frame": ("/base_pose", pose((0, 0, 0.13), frame="map")),
    "velocity in a wrong frame": ("/stage_velocity", velocity(-3e-3, frame="needle_base")),
    "a jump of a metre": ("/base_pose", pose((1, 0, 0.13))),
}


def test_hostile_commands_leave_the_state_as_it_was_and_are_counted(cell):
    cell.start()
    publishers = {
        "/base_pose": cell.publisher(PoseStamped, "/base_pose"),
        "/stage_velocity": cell.publisher(TwistStamped, "/stage_velocity"),
    }
    wrenches = cell.collect(WrenchStamped, "/base_wrench")
    cell.send(publishers["/stage_velocity"], velocity(-3e-3))
    cell.step(5)
    for topic, message in HOSTILE.values():
        cell.send(publishers[topic], message)
    status = cell.step(5)
    assert status["commands_rejected"] == len(HOSTILE)
    assert status["commands_received"] == len(HOSTILE) + 1
    command = BaseCommand(velocity=[0, 0, -3e-3], angular_velocity=[0, 0, 0])
    undisturbed = simulated(cell, [command] * 10)
    cell.until(lambda: len(wrenches) == 10)
    assert [xyz(m.wrench.force) for m in wrenches] == [o.base_force.tolist() for o in undisturbed]
    assert sum(cell.sim.plant.commands.rejected.values()) == len(HOSTILE)


def test_a_command_the_simulator_refuses_holds_the_needle_and_is_said(cell):
    cell.start()
    events = cell.collect(String, "/needle_sim/events")
    publisher = cell.publisher(TwistStamped, "/stage_velocity")
    message = velocity(-3e-3)
    message.twist.linear.y = 1e-3  # out of the plane of a 2D scene
    cell.send(publisher, message)
    before = cell.sim.plant.last_observation
    status = cell.step()
    assert before is None
    assert status["ticks"] == 1
    assert status["commands_rejected"] == 1
    position = cell.sim.plant.last_observation.base_position
    np.testing.assert_array_equal(position, cell.scene_changes["base.position"])
    event = json.loads(cell.until(lambda: events)[0].data)
    assert event["event"] == "command refused"
    assert "2D" in event["reason"] or "plane" in event["reason"]


def test_the_command_timeout_counts_simulated_time(cell):
    cell.start(command_timeout=0.05)
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-3e-3))
    cell.step(12)
    z = cell.sim.plant.last_observation.base_position[2]
    assert z == pytest.approx(0.1302 - 5 * DT * 3e-3, abs=1e-12)


def test_a_pose_is_approached_at_the_speed_limit(cell):
    cell.start(max_base_speed=0.02)
    cell.send(cell.publisher(PoseStamped, "/base_pose"), pose((0, 0, 0.1295)))
    stage = cell.collect(PoseStamped, "/needle_sim/stage_pose")
    cell.step(6)
    cell.until(lambda: len(stage) == 6)
    z = [m.pose.position.z for m in stage]
    np.testing.assert_allclose(z, [0.13, 0.1298, 0.1296, 0.1295, 0.1295, 0.1295], atol=1e-12)
    assert z[-1] == 0.1295


def test_steps_are_refused_while_running_and_pausing_is_idempotent(cell):
    cell.start(paused=False)
    response = cell.call(Trigger, "/needle_sim/step")
    assert not response.success
    assert "pause" in response.message
    first = cell.call(SetBool, "/needle_sim/pause", data=True)
    second = cell.call(SetBool, "/needle_sim/pause", data=True)
    assert first.success and second.success
    ticks = cell.step()["ticks"]
    assert cell.step()["ticks"] == ticks + 1
    response = cell.call(SetBool, "/needle_sim/pause", data=False)
    assert json.loads(response.message)["paused"] is False
    cell.until(lambda: cell.sim.plant.ticks > ticks + 3)


def test_a_reset_starts_over(cell):
    cell.start()
    wrenches = cell.collect(WrenchStamped, "/base_wrench")
    publisher = cell.publisher(TwistStamped, "/stage_velocity")
    for _ in range(2):
        cell.send(publisher, velocity(-3e-3))
        cell.step(8)
        response = cell.call(Trigger, "/needle_sim/reset")
        status = json.loads(response.message)
        assert response.success and (status["time"], status["ticks"]) == (0.0, 0)
    cell.until(lambda: len(wrenches) == 16)
    first, second = wrenches[:8], wrenches[8:]
    assert first == second
    cell.step(1)  # the command did not survive the reset
    np.testing.assert_array_equal(
        cell.sim.plant.last_observation.base_position, cell.scene_changes["base.position"]
    )


def test_the_clock_is_published_only_on_request_and_agrees_with_the_stamps(cell):
    cell.start(publish_clock=True)
    clock = cell.collect(Clock, "/clock")
    wrenches = cell.collect(WrenchStamped, "/base_wrench")
    cell.step(3)
    cell.until(lambda: len(clock) == 3 and len(wrenches) == 3)
    assert [nanoseconds(m.clock) for m in clock] == [10_000_000, 20_000_000, 30_000_000]
    assert [m.clock for m in clock] == [m.header.stamp for m in wrenches]


def test_no_clock_unless_asked_for(cell):
    cell.start()
    assert cell.peer.get_publishers_info_by_topic("/clock") == []


def test_a_clock_from_outside_is_followed_also_backwards(cell):
    sim = cell.start(paused=False, use_sim_time=True)
    publisher = cell.peer.create_publisher(Clock, "/clock", 10)
    cell.until(publisher.get_subscription_count)

    def tell(time_ms):
        message = Clock()
        message.clock.sec, rest = divmod(time_ms, 1000)
        message.clock.nanosec = rest * 1_000_000
        publisher.publish(message)
        cell.until(lambda: sim.get_clock().now().nanoseconds == time_ms * 1_000_000)

    def advance(start_ms, ticks):
        before, time_ms = sim.plant.ticks, start_ms
        while sim.plant.ticks < before + ticks:
            tell(time_ms)
            time_ms += 1
            assert time_ms < start_ms + 1000
        return time_ms - start_ms

    assert sim.plant.ticks == 0
    advance(5000, 3)
    assert advance(2000, 3) <= 60


def test_diagnostics_say_how_it_goes(cell):
    cell.start(paused=False)
    arrays = cell.collect(DiagnosticArray, "/diagnostics")
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-3e-3))
    cell.send(cell.publisher(PoseStamped, "/base_pose"), pose((0, 0, math.nan)))

    def rejected():
        for array in arrays:
            for status in array.status:
                if status.name == "needle_sim: commands" and status.level == DiagnosticStatus.WARN:
                    return array
        return None

    array = cell.until(rejected)
    parts = {s.name: {v.key: v.value for v in s.values} for s in array.status}
    assert set(parts) == {"needle_sim: clock loop", "needle_sim: commands", "needle_sim: recorder"}
    loop = parts["needle_sim: clock loop"]
    assert 0 < float(loop["real_time_factor"]) < 1.5
    assert 0 < float(loop["tick_p50_ms"]) <= float(loop["tick_p99_ms"])
    assert int(loop["overruns"]) >= 0
    assert int(loop["waits_for_solves"]) == 0
    assert loop["factorization"].split()[0] in ("superlu", "pardiso")
    assert loop["compiled"] == ("yes" if compiled_balance.available() else "no")
    commands = parts["needle_sim: commands"]
    assert commands["commands_received"] == "2"
    assert commands["commands_rejected"] == "1"
    assert commands["rejected: not finite"] == "1"
    assert float(commands["command_age_s"]) >= 0
    assert parts["needle_sim: recorder"]["lost"] == "0"


def double(name, value):
    kind = ParameterType.PARAMETER_DOUBLE
    return Parameter(name=name, value=ParameterValue(type=kind, double_value=float(value)))


def test_limits_change_while_running_and_bad_values_are_refused_with_the_reason(cell):
    sim = cell.start()
    integer = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=1)
    changes = [
        double("max_base_speed", 0.002),
        double("max_base_speed", -1.0),
        double("command_timeout", math.nan),
        Parameter(name="command_timeout", value=integer),
        double("rate", 50.0),
        double("interaction.friction.kinetic", 1000.0),
        double("interaction.cutting.force", -1.0),
    ]
    results = cell.call(SetParameters, "/needle_sim/set_parameters", parameters=changes).results
    assert [result.successful for result in results] == [True] + [False] * 6
    reasons = " ".join(result.reason for result in results)
    needed = "interaction.friction.static = 23.0: must be >= interaction.friction.kinetic, 1000"
    for word in ("range", "DOUBLE", "read-only", needed):
        assert word in reasons
    cell.until(lambda: sim.plant.commands.limits.speed == 0.002)
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-3e-3))
    cell.step(1)
    moved = 0.1302 - sim.plant.last_observation.base_position[2]
    assert moved == pytest.approx(0.002 * DT, abs=1e-12)


def test_every_parameter_is_described(cell):
    sim = cell.start()
    own = [
        name
        for name in sim.list_parameters([], 0).names
        if not name.startswith(("use_sim_time", "start_type_description", "qos_overrides"))
    ]
    response = cell.call(DescribeParameters, "/needle_sim/describe_parameters", names=own)
    for descriptor in response.descriptors:
        assert len(descriptor.description) > 10, descriptor.name
        if descriptor.type == ParameterType.PARAMETER_DOUBLE:
            assert descriptor.floating_point_range, descriptor.name
    assert {"scene", "rate", "command_timeout", "max_base_speed", "publish_clock"} <= set(own)
    assert {"record", "tissue_frame", "base_frame", "interaction.cutting.force"} <= set(own)


@pytest.mark.parametrize(
    "parameters, message",
    [
        ({"rate": 100}, "parameter rate = 100 is an integer: write 100.0"),
        ({"rate": -1.0}, "parameter rate = -1.0: must be 0.1 to 10000"),
        ({"command_timeout": math.nan}, "parameter command_timeout = nan"),
        ({"scene": 3}, "parameter scene = 3 is of type integer: must be a string"),
        ({"scene": "gao2017"}, "did you mean 'gao2016'"),
        ({"scene_overrides": "tissue.youngs_modulus=-1"}, "tissue.youngs_modulus = -1"),
        ({"scene_overrides": "tissue"}, "'tissue' is not KEY=VALUE"),
        ({"interaction__friction__static": -2.0}, "interaction.friction.static = -2.0"),
        ({"rate": 1000.0, "scene_overrides": ""}, "not a whole multiple of the scene's solver"),
        ({"publish_clock": True, "use_sim_time": True}, "choose one time source"),
        ({"record": "/proc/nowhere"}, "cannot record in /proc/nowhere"),
    ],
)
def test_a_start_that_cannot_work_is_refused_with_the_reason(cell, parameters, message):
    with pytest.raises(NeedleSimError) as refusal:
        cell.start(**parameters)
    assert message in str(refusal.value)


def test_interaction_parameters_change_the_scene(cell):
    sim = cell.start(interaction__cutting__force=0.123)
    assert sim.plant.scene.interaction.cutting.force == 0.123
    static = Scene.load("gao2016").interaction.friction.static
    assert sim.get_parameter("interaction.friction.static").value == static
