# SPDX-License-Identifier: Apache-2.0
"""Hand-packed CDR is what rclpy reads, for frames of every length and clouds of every size."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped, Vector3Stamped, WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Float64, String

from needle_sim_ros.session import cdr

FRAMES = ["", "a", "tissue", "needle_base", "a/frame/of/23/characters", "gewebe_\u00e4"]
STAMPS = [0, 10_000_000, 61_500_000_000]


def vector(v):
    return [v.x, v.y, v.z]


def members(message):
    if isinstance(message, Vector3Stamped):
        return vector(message.vector)
    if isinstance(message, WrenchStamped):
        return vector(message.wrench.force) + vector(message.wrench.torque)
    if isinstance(message, TwistStamped):
        return vector(message.twist.linear) + vector(message.twist.angular)
    pose = message.pose
    return [*vector(pose.position), *vector(pose.orientation), pose.orientation.w]


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    "kind, count", [(Vector3Stamped, 3), (WrenchStamped, 6), (TwistStamped, 6), (PoseStamped, 7)]
)
def test_stamped_doubles_are_read_back_to_the_last_bit(kind, count, frame):
    values = np.random.default_rng(count).normal(size=count).tolist()
    for stamp in STAMPS:
        data = cdr.stamped_doubles(frame, count)(stamp, values)
        message = deserialize_message(data, kind)
        assert message.header.frame_id == frame
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
        assert members(message) == values
        assert len(data) == len(serialize_message(message))


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("n", [0, 1, 30, 1001])
def test_marker_clouds_are_read_back(frame, n):
    rng = np.random.default_rng(n)
    positions, displacements = rng.normal(size=(2, n, 3))
    encode = cdr.marker_cloud(frame)
    encode(5, np.ones((n, 3)), np.ones((n, 3)))
    data = encode(61_500_000_000, positions, displacements)
    cloud = deserialize_message(data, PointCloud2)
    assert cloud.header.frame_id == frame
    assert cloud.header.stamp == Time(sec=61, nanosec=500_000_000)
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, n, 28, 28 * n)
    assert cloud.is_dense and not cloud.is_bigendian
    names = ["x", "y", "z", "dx", "dy", "dz", "id"]
    kinds = [PointField.FLOAT32] * 6 + [PointField.UINT32]
    expected = [
        PointField(name=name, offset=4 * k, datatype=kind, count=1)
        for k, (name, kind) in enumerate(zip(names, kinds, strict=True))
    ]
    assert cloud.fields == expected
    words = np.frombuffer(bytes(cloud.data), dtype="<f4").reshape(n, 7)
    np.testing.assert_array_equal(words[:, :3], positions.astype(np.float32))
    np.testing.assert_array_equal(words[:, 3:6], displacements.astype(np.float32))
    np.testing.assert_array_equal(words[:, 6].view("<u4"), np.arange(n))
    assert len(data) == len(serialize_message(cloud))


def test_plain_messages_are_read_back():
    assert deserialize_message(cdr.float64(-0.1), Float64).data == -0.1
    for text in ("", "insertion", '{"a": "\u00e4"}'):
        assert deserialize_message(cdr.text(text), String).data == text
    clock = deserialize_message(cdr.clock(1_000_000_007), Clock).clock
    assert (clock.sec, clock.nanosec) == (1, 7)
