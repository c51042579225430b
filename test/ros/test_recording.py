# SPDX-License-Identifier: Apache-2.0
"""The node's recordings: what is published is in the bag, and nothing ends the recording."""

import dataclasses
import resource
import shutil
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped, WrenchStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.scene import Scene
from needle_sim_ros.session.reader import read_session
from needle_sim_ros.session.replay import replay, replay_ticks
from needle_sim_ros.session.resimulate import resimulate, ticks_until
from needle_sim_ros.session.series import Series
from needle_sim_ros.simulator import Simulator

PUBLISHED = {
    "/tip_deflection": Vector3Stamped,
    "/tip_pose": PoseStamped,
    "/base_wrench": WrenchStamped,
    "/tissue_markers": PointCloud2,
    "/insertion_depth": Float64,
    "/process": String,
    "/needle_sim/stage_pose": PoseStamped,
    "/needle_sim/friction_force": Float64,
    "/needle_sim/tip_force": Float64,
    "/needle_sim/tick_time": Float64,
    "/needle_sim/applied_velocity": TwistStamped,
    "/needle_sim/applied_pose": PoseStamped,
    "/needle_sim/events": String,
    "/diagnostics": DiagnosticArray,
}
DT = 0.01
SET_PARAMETERS = "/needle_sim/set_parameters"


def velocity(z):
    message = TwistStamped()
    message.header.frame_id = "tissue"
    message.twist.linear.z = float(z)
    return message


def pose(z):
    message = PoseStamped()
    message.header.frame_id = "tissue"
    message.pose.position.z = float(z)
    message.pose.orientation.x, message.pose.orientation.w = 1.0, 0.0
    return message


def string(name, value):
    kind = ParameterType.PARAMETER_STRING
    return Parameter(name=name, value=ParameterValue(type=kind, string_value=value))


def double(name, value):
    kind = ParameterType.PARAMETER_DOUBLE
    return Parameter(name=name, value=ParameterValue(type=kind, double_value=float(value)))


def mcap_file(folder):
    (file,) = folder.glob("*.mcap")
    return file


def drive(cell):
    """Drive the paused simulator by both kinds of commands; return the number of ticks."""
    velocities = cell.publisher(TwistStamped, "/stage_velocity")
    poses = cell.publisher(PoseStamped, "/base_pose")
    cell.send(velocities, velocity(-0.05))
    cell.step(14)
    cell.send(poses, pose(0.1218))
    cell.step(20)
    cell.send(velocities, velocity(float("nan")))
    cell.send(velocities, velocity(1 / 30))
    return cell.step(6)["ticks"]


def replayed(session):
    """Return the series of a simulator that does what the session says was applied."""
    simulator = Simulator(Scene.from_yaml(session.scene_text))
    dt = float(session.metadata["tick_period"])
    for motion, count in session.before:
        for _ in range(count):
            simulator.step(motion.command(), dt)
    return Series.from_observations(
        simulator.step(motion.command(), dt) for _, motion in session.motions
    )


def assert_same(series, expected):
    for name in ("base_force", "base_torque", "tip_position", "tip_deflection", "base_position"):
        np.testing.assert_array_equal(getattr(series, name), getattr(expected, name), name)
    for name in ("insertion_depth", "friction_force", "tip_force", "base_orientation"):
        np.testing.assert_array_equal(getattr(series, name), getattr(expected, name), name)
    np.testing.assert_allclose(
        series.marker_positions, expected.marker_positions, rtol=0, atol=1e-8
    )
    assert series.process == expected.process


def test_the_bag_holds_exactly_what_was_published(cell, tmp_path):
    cell.start(record=str(tmp_path), max_base_speed=0.02)
    folder = cell.sim.plant.recording
    received = {t: cell.collect(kind, t, raw=True) for t, kind in PUBLISHED.items()}
    ticks = drive(cell)
    cell.until(lambda: len(received["/diagnostics"]) > 0)
    response = cell.call(SetBool, "/needle_sim/record", data=False)
    assert response.success and response.message.startswith(str(folder))
    for topic in ("/base_wrench", "/process", "/tissue_markers", "/needle_sim/stage_pose"):
        cell.until(lambda topic=topic: len(received[topic]) == ticks)
    cell.until(lambda: any(b"stopped" in data for data in received["/needle_sim/events"]))

    store = get_typestore(Stores.ROS2_JAZZY)
    bag = {topic: [] for topic in (*PUBLISHED, "/base_pose", "/stage_velocity")}
    with Reader(folder) as reader:
        assert set(bag) == {c.topic for c in reader.connections}
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert reader.message_count == sum(counts.values())
        for connection, stamp, data in reader.messages():
            store.deserialize_cdr(data, connection.msgtype)
            bag[connection.topic].append((stamp, bytes(data)))
    assert counts == {topic: len(messages) for topic, messages in bag.items()}
    assert counts["/base_wrench"] == ticks == 40
    assert counts["/needle_sim/applied_velocity"] + counts["/needle_sim/applied_pose"] == ticks
    assert (counts["/base_pose"], counts["/stage_velocity"]) == (1, 3)
    for topic in PUBLISHED:
        recorded = [data for _, data in bag[topic]]
        if topic in ("/diagnostics", "/needle_sim/events"):
            # What was published before the peer listened, or after the recording ended.
            common = [data for data in received[topic] if data in recorded]
            assert common and recorded[-len(common) :] == common
        else:
            assert recorded == received[topic], topic
    wrench = deserialize_message(bag["/base_wrench"][5][1], WrenchStamped)
    assert bag["/base_wrench"][5][0] == wrench.header.stamp.nanosec == 60_000_000

    decoded = dict.fromkeys(bag, 0)
    with mcap_file(folder).open("rb") as stream:
        reader = make_reader(stream, True, [DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, value in reader.iter_decoded_messages():
            kind = PUBLISHED.get(channel.topic)
            decoded[channel.topic] += 1
            if kind is WrenchStamped:
                expected = deserialize_message(message.data, WrenchStamped)
                assert value.wrench.force.z == expected.wrench.force.z
                assert value.header.stamp.nanosec == expected.header.stamp.nanosec
        for channel in reader.get_summary().channels.values():
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            assert "reliability: reliable" in channel.metadata["offered_qos_profiles"]
    assert decoded == counts


def test_the_session_alone_replays_to_the_bit(cell, tmp_path):
    cell.start(record=str(tmp_path), max_base_speed=0.02)
    ticks = drive(cell)
    folder, status = cell.sim.plant.stop_recording()
    assert (status.lost, status.error) == (0, "")
    session = read_session(folder)
    assert session.complete
    assert Scene.from_yaml(session.scene_text) == cell.sim.plant.scene
    assert session.before == []
    assert len(session.series) == len(session.motions) == ticks
    assert {motion.kind for _, motion in session.motions} == {"pose", "velocity"}
    assert [role for _, role, _ in session.inputs] == [
        "stage_velocity",
        "base_pose",
        "stage_velocity",
        "stage_velocity",
    ]
    assert session.inputs[1][0] == 140_000_000
    assert session.metadata["package_version"] and session.metadata["numpy"]
    assert session.metadata["parameter.max_base_speed"] == "0.02"
    assert_same(session.series, replayed(session))


def test_a_recording_that_starts_late_knows_what_came_before(cell, tmp_path):
    cell.start(record="", max_base_speed=0.02)
    velocities = cell.publisher(TwistStamped, "/stage_velocity")
    cell.send(velocities, velocity(-0.02))
    cell.step(15)
    cell.sim.plant.start_recording(tmp_path)
    cell.step(5)
    cell.send(velocities, velocity(0.01))
    cell.step(5)
    folder, _ = cell.sim.plant.stop_recording()
    session = read_session(folder)
    assert session.metadata["start_tick"] == "15"
    assert [count for _, count in session.before] == [15]
    assert len(session.series) == 10
    assert_same(session.series, replayed(session))


def change(cell, **values):
    """Change interaction laws, all at once; dots are written as double underscores."""
    parameters = [double(f"interaction.{k.replace('__', '.')}", v) for k, v in values.items()]
    name = "/needle_sim/set_parameters_atomically"
    result = cell.call(SetParametersAtomically, name, parameters=parameters).result
    assert result.successful, result.reason


@pytest.mark.parametrize("late", [False, True])
def test_laws_that_change_while_running_are_recorded_and_replayed_to_the_bit(cell, tmp_path, late):
    sim = cell.start(record="" if late else str(tmp_path), record_root=str(tmp_path))
    velocities = cell.publisher(TwistStamped, "/stage_velocity")
    before = sim.plant.current_scene.interaction
    change(cell, cutting__force=0.6)  # before the first tick
    cell.send(velocities, velocity(-0.1))
    cell.step(15)
    change(cell, friction__static=50.0, friction__kinetic=45.0)  # alone, kinetic would be refused
    cell.step(5)
    if late:
        sim.plant.start_recording(tmp_path)
    cell.step(5)
    change(cell, friction__kinetic=5.0)
    change(cell, friction__kinetic=40.0, puncture__force=0.7)
    cell.step(5)
    wrench = sim.plant.last_observation.base_force[2]
    assert cell.call(Trigger, "/needle_sim/reset").success
    cell.send(velocities, velocity(-0.1))
    change(cell, cutting__relaxation_time=0.5)
    cell.step(15)
    folder, _ = sim.plant.stop_recording()
    session = read_session(folder)
    assert Scene.from_yaml(session.scene_text).interaction == before
    ticks = replay_ticks(session)
    assert len(ticks) == 45
    done = replay(session.metadata, Simulator(Scene.from_yaml(session.scene_text)), ticks)
    assert_same(session.series, done.series)
    row = 9 if late else 29  # the last tick before the reset
    assert session.series.base_force[row, 2] == wrench
    unchanged = replay(
        session.metadata,
        Simulator(Scene.from_yaml(session.scene_text)),
        [dataclasses.replace(tick, changes=()) for tick in ticks],
    )
    assert abs(unchanged.series.base_force[row, 2] - wrench) > 0.1
    until = ticks_until(session, len(session.series) - 1)
    assert len(until) == 15
    *_, (_, simulator, observation) = resimulate(session, until)
    np.testing.assert_array_equal(observation.base_force, session.series.base_force[-1])
    assert simulator.scene.interaction == sim.plant.current_scene.interaction


def test_a_recording_that_starts_after_a_reset_has_the_laws_of_then(cell, tmp_path):
    sim = cell.start(record_root=str(tmp_path))
    change(cell, cutting__force=0.6)
    assert cell.call(Trigger, "/needle_sim/reset").success
    folder = sim.plant.start_recording(tmp_path)
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-0.1))
    cell.step(15)
    sim.plant.stop_recording()
    session = read_session(folder)
    assert Scene.from_yaml(session.scene_text).interaction.cutting.force == 0.6
    assert session.metadata["parameter.interaction.cutting.force"] == "0.6"
    scene = Scene.from_yaml(session.scene_text)
    done = replay(session.metadata, Simulator(scene), replay_ticks(session))
    assert_same(session.series, done.series)


def test_bytes_that_are_no_message_end_neither_node_nor_session(cell, tmp_path):
    cell.start(record=str(tmp_path))
    publisher = cell.publisher(PoseStamped, "/base_pose")
    good = serialize_message(pose(0.13))
    wrong_text = good[:16] + b"\xff\xfe\xfd\xfc" + good[20:]
    too_long = good[:12] + b"\xff\xff\xff\xff" + good[16:]
    for data in (b"", b"garbage", good[:20], too_long, wrong_text, good + bytes(5000)):
        cell.send(publisher, data)
        cell.step()
    assert cell.sim.plant.commands.rejected["unreadable"] == 4
    assert cell.sim.plant.commands.rejected["frame is not tissue"] == 1
    folder, status = cell.sim.plant.stop_recording()
    assert status.lost == 0
    session = read_session(folder)
    assert session.complete and len(session.series) == 6
    assert [message.header.frame_id for _, _, message in session.inputs][1] == "tissue"
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(folder) as reader:
        for connection, _, data in reader.messages():
            store.deserialize_cdr(data, connection.msgtype)
            assert connection.topic != "/base_pose" or len(data) < 200


def test_log_time_never_goes_back_over_resets_and_events_say_what_happened(cell, tmp_path):
    cell.start(record=str(tmp_path))
    cell.step(3)
    assert cell.call(Trigger, "/needle_sim/reset").success
    cell.step(2)
    assert cell.call(SetBool, "/needle_sim/pause", data=False).success
    assert cell.call(SetBool, "/needle_sim/pause", data=True).success
    folder, _ = cell.sim.plant.stop_recording()
    session = read_session(folder)
    names = [event["event"] for _, event in session.events]
    assert names == ["recording started", "reset", "resumed", "paused", "recording stopped"]
    times = [time for time, _ in session.events]
    assert times == sorted(times)
    assert times[1] == 30_000_000
    np.testing.assert_allclose(np.diff(session.series.time), DT, atol=1e-9)


def test_recording_by_service_refuses_with_the_reason_and_never_overwrites(cell, tmp_path):
    cell.start(record=str(tmp_path))
    response = cell.call(SetBool, "/needle_sim/record", data=True)
    assert not response.success and "already recording" in response.message
    assert cell.call(SetBool, "/needle_sim/record", data=False).success
    response = cell.call(SetBool, "/needle_sim/record", data=False)
    assert not response.success and "not recording" in response.message
    for _ in range(2):
        assert cell.call(SetBool, "/needle_sim/record", data=True).success
        assert cell.call(SetBool, "/needle_sim/record", data=False).success
    assert len(list(tmp_path.iterdir())) == 3
    (tmp_path / "file").write_text("")
    change = string("record", str(tmp_path / "file"))
    (result,) = cell.call(SetParameters, SET_PARAMETERS, parameters=[change]).results
    assert result.successful
    response = cell.call(SetBool, "/needle_sim/record", data=True)
    assert not response.success and "Not a directory" in response.message
    assert cell.step(1)["ticks"] == 1


def test_nobody_records_outside_the_folder_given(cell, tmp_path):
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (inside / "link").symlink_to(outside)
    cell.start(record_root=str(inside))

    def set_record(folder):
        change = string("record", str(folder))
        return cell.call(SetParameters, SET_PARAMETERS, parameters=[change]).results[0]

    for folder in (outside, inside / ".." / "outside", inside / "link", "/", "/etc", ".", "~"):
        result = set_record(folder)
        assert not result.successful
        assert f"must be inside {inside}" in result.reason
    assert set_record(inside / "deeper").successful
    response = cell.call(SetBool, "/needle_sim/record", data=True)
    assert response.success and response.message.startswith(str(inside / "deeper"))
    assert cell.call(SetBool, "/needle_sim/record", data=False).success
    (inside / "deeper").rename(inside / "was")
    (inside / "deeper").symlink_to(outside)  # after it was checked
    response = cell.call(SetBool, "/needle_sim/record", data=True)
    assert not response.success and "must be inside" in response.message
    assert list(outside.iterdir()) == []
    assert set_record("").successful
    response = cell.call(SetBool, "/needle_sim/record", data=True)
    assert response.success and response.message.startswith(str(inside))


def test_sessions_go_on_in_other_files_when_asked_for(cell, tmp_path):
    sim = cell.start(record=str(tmp_path), record_split_duration=0.1)
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-0.1))
    cell.step(25)
    folder, status = sim.plant.stop_recording()
    assert status.lost == 0
    assert len(list(folder.glob("*.mcap"))) == 3
    changes = [double("record_split_duration", 0.0), double("record_split_size", 1.0)]
    results = cell.call(SetParameters, SET_PARAMETERS, parameters=changes).results
    assert all(result.successful for result in results)
    session = read_session(folder)
    assert len(session.series) == 25
    assert_same(session.series, replayed(session))
    assert cell.sim.simulation.record_folder.split.size == 1.0
    with Reader(folder) as reader:
        assert reader.message_count == status.written


def test_starts_and_stops_while_moving_give_sessions_that_each_replay(cell, tmp_path):
    sim = cell.start(record_root=str(tmp_path), rate=200.0)
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), velocity(-0.02))
    assert cell.call(SetBool, "/needle_sim/pause", data=False).success
    folders = []
    for _ in range(4):
        response = cell.call(SetBool, "/needle_sim/record", data=True)
        assert response.success, response.message
        ticks = sim.plant.ticks
        cell.until(lambda ticks=ticks: sim.plant.ticks > ticks + 10)
        folders.append(sim.plant.recording)
        assert cell.call(SetBool, "/needle_sim/record", data=False).success
    assert len(set(folders)) == 4
    for folder in folders:
        session = read_session(folder)
        assert session.complete and len(session.series) >= 10
        np.testing.assert_allclose(np.diff(session.series.time), 0.005, atol=1e-9)
    assert_same(session.series, replayed(session))


def test_two_nodes_record_side_by_side(node_process, tmp_path):
    place = tmp_path / "bags"
    nodes = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        nodes.append(node_process(f"record:={place}", folder=tmp_path / name))
    for node in nodes:
        node.until_running()
    nodes[0].until(lambda: len(list(place.glob("*/*.mcap"))) == 2)
    nodes[0].until(lambda: all(file.stat().st_size > 40_000 for file in place.glob("*/*.mcap")))
    for node in nodes:
        status, _ = node.end()
        assert status == 0, node.output()
    for folder in place.iterdir():
        session = read_session(folder)
        assert session.complete and len(session.series) == len(session.motions) > 20


def test_a_folder_that_is_removed_is_said_and_does_not_end_the_node(node_process, tmp_path):
    node = node_process(f"record:={tmp_path / 'bags'}")
    node.until_running()
    node.until(lambda: list((tmp_path / "bags").glob("*/*.mcap")))
    shutil.rmtree(tmp_path / "bags")
    node.until(lambda: "was removed" in node.output())
    status, _ = node.end()
    assert status == 0, node.output()
    assert "Traceback" not in node.output()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_finish_the_recording_and_exit_0(node_process, tmp_path, number):
    node = node_process(f"record:={tmp_path}")
    node.until_running()
    folder = node.session()
    status, took = node.end(number)
    assert status == 0, node.output()
    assert took < 5
    session = read_session(folder)
    assert session.complete
    with Reader(folder) as reader:
        assert reader.message_count > 100
    assert session.events[-1][1]["event"] == "recording stopped"
    assert "Traceback" not in node.output()


def test_after_kill_9_all_but_the_last_half_second_is_there(cell, node_process, tmp_path):
    node = node_process(f"record:={tmp_path}")
    node.until_running()
    folder = node.session()
    heard = cell.collect(WrenchStamped, "/base_wrench")
    node.until(lambda: len(heard) > 100)
    node.end(signal.SIGKILL)
    before = mcap_file(folder).read_bytes()
    session = read_session(folder)
    assert not session.complete
    assert len(session.series) == len(session.motions)
    np.testing.assert_allclose(np.diff(session.series.time), DT, atol=1e-9)
    last = heard[-1].header.stamp
    assert last.sec + last.nanosec * 1e-9 - session.series.time[-1] < 0.5
    assert mcap_file(folder).read_bytes() == before


def test_a_disk_that_fills_up_ends_neither_simulation_nor_recording(node_process, tmp_path):
    node = node_process(f"record:={tmp_path}")
    node.until_running()
    folder = node.session()
    size = mcap_file(folder).stat().st_size
    pid, unlimited = node.process.pid, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size + 1000, resource.RLIM_INFINITY))
    node.until(lambda: "messages not recorded: File too large" in node.output())
    resource.prlimit(pid, resource.RLIMIT_FSIZE, unlimited)
    node.until(lambda: mcap_file(folder).stat().st_size > size + 50_000)
    status, _ = node.end()
    assert status == 0, node.output()
    assert "lost" in node.output()
    session = read_session(folder)
    assert session.complete
    gaps = np.diff(session.series.time)
    assert gaps.max() > 1.5 * DT
    with Reader(folder) as reader:
        assert reader.message_count > 100


def test_a_slow_disk_holds_up_no_tick_and_loses_nothing(cell, node_process, tmp_path):
    """Every write takes 0.6 s: ticks are heard while one is under way, and all are in the bag."""
    compiler, library = shutil.which("cc"), tmp_path / "slow_disk.so"
    if compiler is None:
        pytest.skip("no C compiler")
    source = Path(__file__).with_name("slow_disk.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    slow = {"LD_PRELOAD": str(library), "DISK_MICROSECONDS": "600000"}
    node = node_process(f"record:={tmp_path}", environment=slow)
    node.until_running()
    file = mcap_file(node.session())
    heard = cell.collect(WrenchStamped, "/base_wrench")

    def ticked_through_a_write():
        size, count = file.stat().st_size, len(heard)
        node.until(lambda: len(heard) > count + 40)  # twice what comes between two writes
        return file.stat().st_size == size

    node.until(ticked_through_a_write)
    status, _ = node.end()
    assert status == 0, node.output()
    assert "lost" not in node.output()
    session = read_session(file.parent)
    assert session.complete
    np.testing.assert_allclose(np.diff(session.series.time), DT, atol=1e-9)
    last = heard[-1].header.stamp
    assert session.series.time[-1] >= last.sec + last.nanosec * 1e-9 - 1e-9


@pytest.mark.parametrize(
    "argument, message",
    [
        ("scene:=/nowhere.yaml", "no such file"),
        ("record:=/proc/nowhere", "cannot record in /proc/nowhere"),
    ],
)
def test_a_node_that_cannot_start_says_why_and_exits_1(node_process, argument, message):
    node = node_process(argument)
    assert node.process.wait(30) == 1
    assert message in node.output()
    assert "Traceback" not in node.output()
