# SPDX-License-Identifier: Apache-2.0
"""`visualization` and `needle_shape` over real topics: right, on demand, not too often."""

import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Path
from visualization_msgs.msg import Marker, MarkerArray

from needle_sim_ros.view.shapes import Shapes

REGION = (
    '[{"name": "lump", "shape": "ellipsoid", "center": [0, 0, -0.05], "size": [0.02, 1, 0.02]}]'
)


def down(speed=-0.05):
    message = TwistStamped()
    message.header.frame_id = "tissue"
    message.twist.linear.z = speed
    return message


def rows(points):
    return np.array([[p.x, p.y, p.z] for p in points]).reshape(-1, 3)


def test_the_markers_are_the_shapes_of_the_last_tick(cell):
    sim = cell.start(scene_overrides=f"{cell.overrides}; tissue.regions={REGION}")
    cell.send(cell.publisher(TwistStamped, "stage_velocity"), down())
    cell.step(25)
    heard = cell.collect(MarkerArray, "visualization")
    lines = cell.collect(Path, "needle_shape")
    cell.until(lambda: heard and lines, "pictures")
    seen = sim.plant.last_observation
    markers = {marker.ns: marker for marker in heard[0].markers}
    expected = Shapes(sim.plant.scene).of(seen, lambda p: sim.plant.tissue_displacement(p, seen))
    assert set(markers) == {shape.name for shape in expected}
    for shape in expected:
        marker = markers[shape.name]
        assert (marker.id, marker.type, marker.action) == (0, int(shape.kind), Marker.ADD)
        assert marker.header.frame_id == "tissue" and marker.pose.orientation.w == 1.0
        assert np.array_equal(rows(marker.points), shape.points), shape.name
        stamp = marker.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(seen.time)
        assert (marker.scale.x, marker.scale.y, marker.scale.z) == pytest.approx(shape.scale)
    tissue = markers["tissue"]
    assert len(tissue.colors) == len(tissue.points) > 1000
    assert 0.5 < tissue.colors[0].a < 1.0
    line = lines[0]
    assert line.header.frame_id == "tissue"
    assert np.array_equal(rows(p.pose.position for p in line.poses), seen.needle_points)


def test_what_is_gone_is_taken_away(cell):
    cell.start()
    cell.step(1)
    heard = cell.collect(MarkerArray, "visualization")
    cell.until(lambda: heard, "picture")
    actions = {marker.ns: marker.action for marker in heard[0].markers}
    assert actions["track"] == actions["force"] == Marker.DELETE
    assert actions["tissue"] == actions["needle"] == Marker.ADD


def test_nothing_is_made_unless_somebody_listens(cell):
    sim = cell.start(paused=False)
    shown = sim.simulation.visualization
    cell.until(lambda: sim.plant.total_ticks > 30, "ticks")
    assert shown.rounds == 0
    lines = cell.collect(Path, "needle_shape")
    cell.until(lambda: len(lines) > 2, "lines")
    assert shown.rounds > 0


@pytest.mark.parametrize("rate", [20.0, 5.0])
def test_no_more_than_so_many_a_second(cell, rate):
    cell.start(paused=False, visualization_rate=rate)
    begun = time.monotonic()
    arrived = []
    cell.peer.create_subscription(
        MarkerArray, "visualization", lambda _: arrived.append(time.monotonic()), 10
    )
    cell.until(lambda: len(arrived) >= 6, "pictures")
    assert arrived[-1] - begun >= 0.9 * (len(arrived) - 2) / rate
    assert (arrived[5] - arrived[0]) >= 0.8 * 5 / rate


def test_the_rate_has_bounds(cell):
    from needle_sim_ros.errors import NeedleSimError

    with pytest.raises(NeedleSimError, match=r"visualization_rate.*0\.1 to 20"):
        cell.start(visualization_rate=50.0)
