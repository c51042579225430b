# SPDX-License-Identifier: Apache-2.0
"""Bags that others recorded: types, frames, clocks, losses, and what is refused."""

import numpy as np
import pytest
from mcap_ros2._dynamic import serialize_dynamic

from needle_sim_ros.errors import SessionError
from needle_sim_ros.session.bag import Bag, Topic
from needle_sim_ros.session.experiment import begun_at
from needle_sim_ros.session.foreign import read_experiment
from needle_sim_ros.session.mapping import Mapping, read_mapping
from needle_sim_ros.session.schema import message_schema

EPOCH = 1_700_000_000_000_000_000  # ns
FALL = np.array([0.0, 0.0, -5e-3])  # m/s


def header(time, stamped=True):
    sec, nanosec = divmod(EPOCH + round(time * 1e9), 10**9) if stamped else (0, 0)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "world"}


def xyz(vector):
    return dict(zip("xyz", map(float, vector), strict=True))


def pose(place, turned=(1.0, 0.0, 0.0, 0.0)):
    return {"position": xyz(place), "orientation": dict(zip("xyzw", turned, strict=True))}


@pytest.fixture
def bag(tmp_path):
    """Write topics, given as name to (type, [(time in s, message)]), into a bag."""

    def make(topics, name="foreign"):
        written = Bag(tmp_path / name)
        entries = []
        for topic, (kind, messages) in topics.items():
            number = written.add_topic(Topic(topic, kind))
            encode = serialize_dynamic(kind, message_schema(kind).text)[kind]
            entries += [
                (number, k, EPOCH + 50_000 + round(t * 1e9), encode(m))
                for k, (t, m) in enumerate(messages)
            ]
        entries.sort(key=lambda entry: entry[2])
        if entries:
            written.write(entries)
        written.close()
        return tmp_path / name

    return make


def falling(times, start=(0.0, 0.0, 0.14), stamped=True):
    messages = [
        (t, {"header": header(t, stamped), "pose": pose(np.array(start) + t * FALL)}) for t in times
    ]
    return "geometry_msgs/msg/PoseStamped", messages


def wrenches(times, force):
    messages = [
        (t, {"header": header(t), "wrench": {"force": xyz(force(t)), "torque": xyz((0, 0, 0))}})
        for t in times
    ]
    return "geometry_msgs/msg/WrenchStamped", messages


def places(experiment):
    return np.array([motion.linear for motion in experiment.motions])


def test_uneven_and_lost_poses_come_out_on_even_ticks(bag, coarse_scene):
    times = np.delete(np.cumsum([0, *np.random.default_rng(1).uniform(0.01, 0.05, 60)]), [20, 21])
    path = bag({"/ee": falling(times)})
    scene = coarse_scene({"solver.time_step": 0.02})
    experiment = read_experiment(path, read_mapping(None, ["base_pose:=/ee"]), scene)
    ends = experiment.ends[1:]
    assert experiment.tick_period == 0.02 and len(ends) == round(times[-1] / 0.02)
    inside = ends <= times[-1]
    expected = 0.14 - 5e-3 * ends[inside]
    np.testing.assert_allclose(places(experiment)[inside, 2], expected, atol=1e-9)
    assert experiment.scene(scene).base.position == pytest.approx((0.0, 0.0, 0.14))


def test_velocities_are_held_over_lost_messages(bag, coarse_scene):
    twist = {"linear": xyz(FALL), "angular": xyz((0, 0, 0))}
    times = [0.0, 0.1, 0.2, 0.7, 0.8]
    messages = [(t, {"header": header(t), "twist": twist}) for t in times]
    path = bag({"/v": ("geometry_msgs/msg/TwistStamped", messages)})
    mapping = read_mapping(None, ["stage_velocity:=/v"])
    experiment = read_experiment(path, mapping, coarse_scene({"solver.time_step": 0.05}))
    np.testing.assert_allclose(places(experiment)[:16], np.tile(FALL, (16, 1)), atol=1e-12)


def test_transforms_and_joints_move_the_base_too(bag, coarse_scene):
    times = np.arange(0, 1.01, 0.1)
    transforms = []
    for t in times:
        at = {
            "translation": xyz((0, 0, 0.14) + t * FALL),
            "rotation": pose((0, 0, 0))["orientation"],
        }
        transforms.append((t, {"header": header(t), "transform": at, "child_frame_id": "ee"}))
    joints = [
        (
            t,
            {
                "header": header(t),
                "name": ["other", "z_stage"],
                "position": [9.0, 0.3 + 5e-3 * t],
                "velocity": [],
                "effort": [],
            },
        )
        for t in times
    ]
    path = bag(
        {
            "/tf": ("geometry_msgs/msg/TransformStamped", transforms),
            "/joints": ("sensor_msgs/msg/JointState", joints),
        }
    )
    scene = coarse_scene({"solver.time_step": 0.1})
    one = read_experiment(path, read_mapping(None, ["base_pose:=/tf"]), scene)
    mapping = read_mapping(None, ["base_pose:=/joints"])
    with pytest.raises(SessionError, match="name one of other, z_stage"):
        read_experiment(path, mapping, scene)
    file = path.parent / "map.yaml"
    file.write_text("base_pose: {topic: /joints, joint: z_stage, axis: [0, 0, -1]}\n")
    other = read_experiment(path, read_mapping(file, []), scene)
    np.testing.assert_allclose(places(one), places(other), atol=1e-9)
    assert places(one)[-1] == pytest.approx((0, 0, 0.135))


def test_frames_bias_and_sign_of_a_force_sensor(bag, tmp_path, coarse_scene):
    times = np.arange(0, 2.0, 0.05)
    path = bag(
        {
            "/ee": falling(times),
            "/ft": wrenches(times, lambda t: (0.1, 0.3, 0.2) if t < 1 else (0.6, 0.3, 1.2)),
        }
    )
    file = tmp_path / "map.yaml"
    file.write_text(
        "base_pose: /ee\n"
        "wrench: {topic: /ft, sign: -1, bias_time: 0.5, transform: {translation: [0, 0, 0.1],"
        " rotation: [0, 0, 0.70710678, 0.70710678]}}\n"
    )
    measured = read_experiment(path, read_mapping(file, []), coarse_scene()).measured
    force, torque = measured["force"].values[-1], measured["torque"].values[-1]
    np.testing.assert_allclose(force, (0.0, -0.5, -1.0), atol=1e-7)  # x of the sensor is base y
    np.testing.assert_allclose(torque, np.cross((0, 0, 0.1), force), atol=1e-7)


@pytest.mark.parametrize("kind", ["cloud", "poses", "markers"])
def test_beads_by_any_type_give_displacements(bag, coarse_scene, kind):
    times = np.arange(0, 2.01, 0.1)
    rest = np.array([[-0.01, 0.0, -0.02], [-0.02, 0.0, -0.03]])
    messages = []
    for t in times:
        now = rest + (0.0 if t < 1 else 1e-3) * np.array([1.0, 0.0, 0.0])
        if kind == "cloud":
            names = ("x", "y", "z", "id")
            fields = [
                {"name": n, "offset": 4 * k, "datatype": 6 if n == "id" else 7, "count": 1}
                for k, n in enumerate(names)
            ]
            data = np.zeros(2, dtype=[("p", "<f4", 3), ("id", "<u4")])
            data["p"], data["id"] = now[::-1], [7, 4]
            message = {
                "header": header(t),
                "height": 1,
                "width": 2,
                "fields": fields,
                "is_bigendian": False,
                "point_step": 16,
                "row_step": 32,
                "data": data.tobytes(),
                "is_dense": True,
            }
        elif kind == "poses":
            message = {"header": header(t), "poses": [pose(place) for place in now]}
        else:
            shown = [
                {"header": header(t), "ns": "b", "id": k, "action": 0, "pose": pose(place)}
                for k, place in enumerate(now)
            ]
            message = {"markers": shown if t != times[4] else shown[:1]}
        messages.append((t, message))
    types = {
        "cloud": "sensor_msgs/msg/PointCloud2",
        "poses": "geometry_msgs/msg/PoseArray",
        "markers": "visualization_msgs/msg/MarkerArray",
    }
    path = bag({"/ee": falling(times), "/beads": (types[kind], messages)})
    mapping = read_mapping(None, ["base_pose:=/ee", "markers:=/beads"])
    experiment = read_experiment(path, mapping, coarse_scene())
    np.testing.assert_allclose(experiment.markers, rest, atol=1e-7)
    moved = experiment.measured["markers"].values
    np.testing.assert_allclose(moved[-1], [[1e-3, 0, 0]] * 2, atol=1e-7)
    if kind == "markers":
        assert np.isnan(moved[4, 1]).all() and np.isfinite(moved[4, 0]).all()


def test_another_clock_in_one_topic_means_log_times(bag, coarse_scene):
    times = np.arange(0, 1.0, 0.05)
    kind, messages = wrenches(times, lambda t: (0, 0, t))
    for _, message in messages:
        message["header"]["stamp"]["sec"] = 12
    path = bag({"/ee": falling(times), "/ft": (kind, messages)})
    mapping = read_mapping(None, ["base_pose:=/ee", "wrench:=/ft"])
    experiment = read_experiment(path, mapping, coarse_scene())
    assert "another clock" in experiment.notes[0]
    np.testing.assert_allclose(experiment.measured["force"].time, times, atol=1e-6)


def test_what_is_wrong_with_a_bag_is_one_clear_message(bag, coarse_scene, tmp_path):
    scene, times = coarse_scene(), [0.0, 0.1, 0.2]
    mapping = read_mapping(None, ["base_pose:=/ee"])
    with pytest.raises(SessionError, match="empty"):
        read_experiment(bag({}, "empty"), mapping, scene)
    path = bag({"/other": falling(times)}, "other")
    with pytest.raises(SessionError, match="no command topic: /ee is not in the bag"):
        read_experiment(path, mapping, scene)
    with pytest.raises(SessionError, match="--topic base_pose:=NAME; its topics: /other"):
        read_experiment(path, None, scene)
    kind, messages = falling(times)
    back = [messages[0], (0.1, messages[2][1]), (0.2, messages[1][1])]
    with pytest.raises(SessionError, match="times go backwards"):
        read_experiment(bag({"/ee": (kind, back)}, "back"), mapping, scene)
    wrong = bag({"/ee": wrenches(times, lambda t: (0, 0, 0))}, "wrong")
    with pytest.raises(SessionError, match="base_pose cannot be geometry_msgs/msg/WrenchStamped"):
        read_experiment(wrong, mapping, scene)
    with pytest.raises(SessionError, match="give one with --scene"):
        read_experiment(bag({"/ee": falling(times)}, "fine"), mapping, None)
    nothing = tmp_path / "text.mcap"
    nothing.write_text("no bag")
    with pytest.raises(SessionError, match="not an MCAP file"):
        read_experiment(nothing, mapping, scene)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("base_pose: {topic: /ee, joints: z}", "did you mean 'joint'"),
        ("wrench: {topic: /ft, sign: 2}", "wrench.sign = 2"),
        ("wrench: {topic: /ft, transform: {rotation: [0, 0, 0, 0]}}", "zero quaternion"),
        ("wrench: {topic: /ft, axes: w}", "letters of xyz"),
        ("base_pose: [", "not valid YAML"),
    ],
)
def test_a_mapping_says_what_is_wrong_with_it(tmp_path, text, message):
    file = tmp_path / "map.yaml"
    file.write_text(text)
    with pytest.raises(SessionError, match=message):
        read_mapping(file, [])


def test_pairs_lie_over_the_file(tmp_path):
    assert read_mapping(None, []) is None
    file = tmp_path / "map.yaml"
    file.write_text("wrench: {topic: /a, sign: -1}\nclock: log\n")
    mapping = read_mapping(file, ["wrench:=/b"])
    assert isinstance(mapping, Mapping)
    assert (mapping.wrench.topic, mapping.wrench.sign, mapping.clock) == ("/b", -1, "log")
    with pytest.raises(SessionError, match="ROLE:=TOPIC"):
        read_mapping(None, ["force:=/b"])


def test_a_protocol_that_cannot_begin_where_the_experiment_did_is_left_out(coarse_scene):
    """It is not what moved the base: a base farther up may have come farther down."""
    scene = coarse_scene()
    x, y, z = scene.base.position
    near = begun_at(scene, (x + 1e-3, y, z), scene.base.orientation)
    assert near.base.position == (x + 1e-3, y, z) and near.protocol == scene.protocol
    far = begun_at(scene, (x, y, z + 0.3), scene.base.orientation)
    assert far.base.position == (x, y, z + 0.3) and far.protocol == ()
    assert far.needle == scene.needle and far.tissue == scene.tissue
