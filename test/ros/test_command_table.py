# SPDX-License-Identifier: Apache-2.0
"""Every row of the table of commands in doc/node.md, over real topics."""

import math
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from std_srvs.srv import SetBool

DT = 0.01
START = 0.1302  # m, height of the base
SPEED = 0.02  # m/s, limit
PAGE = Path(__file__).parents[2] / "doc" / "node.md"


def velocity(z, frame="tissue", stamp=0, x=0.0, y=0.0, turn=0.0):
    message = TwistStamped()
    message.header.frame_id, message.header.stamp.sec = frame, stamp
    linear = message.twist.linear
    linear.x, linear.y, linear.z = float(x), float(y), float(z)
    message.twist.angular.y = float(turn)
    return message


def pose(z, frame="tissue", stamp=0, orientation=(1.0, 0.0, 0.0, 0.0)):
    message = PoseStamped()
    message.header.frame_id, message.header.stamp.sec = frame, stamp
    message.pose.position.z = float(z)
    q = message.pose.orientation
    q.x, q.y, q.z, q.w = map(float, orientation)
    return message


class Bench:
    """The paused node with a publisher on each topic."""

    def __init__(self, cell, **parameters):
        self.cell = cell
        given = {"command_timeout": 0.5, "max_base_speed": SPEED, **parameters}
        self.sim = cell.start(**given)
        self.poses = cell.publisher(PoseStamped, "/base_pose")
        self.velocities = cell.publisher(TwistStamped, "/stage_velocity")

    def send(self, message, publisher=None):
        own = self.poses if isinstance(message, PoseStamped) else self.velocities
        self.cell.send(publisher or own, message)

    def step(self, times=1):
        self.cell.step(times)
        return self.sim.plant.position[2]

    def ignored(self, message, reason):
        """Send a message and check that it is counted and changes nothing."""
        before = self.step()
        rejected = self.sim.plant.commands.rejected[reason]
        self.send(message)
        assert self.sim.plant.commands.rejected[reason] == rejected + 1
        after = self.step()
        assert after - before == pytest.approx(-3e-3 * DT, abs=1e-12)


def velocity_held(bench):
    bench.send(velocity(-3e-3))
    assert bench.step(10) == pytest.approx(START - 10 * DT * 3e-3, abs=1e-12)


def velocity_too_fast(bench):
    bench.send(velocity(-0.04, x=0.03))
    bench.step()
    x, _, z = bench.sim.plant.position
    assert (x, START - z) == pytest.approx((0.6 * SPEED * DT, 0.8 * SPEED * DT), abs=1e-12)


def pose_step(bench):
    bench.send(pose(START - 2.5 * SPEED * DT))
    heights = [bench.step() for _ in range(4)]
    assert heights[:2] == pytest.approx([START - SPEED * DT, START - 2 * SPEED * DT], abs=1e-12)
    assert heights[2] == heights[3] == START - 2.5 * SPEED * DT


def pose_ramp(bench):
    targets = [START - k * 0.9 * SPEED * DT for k in range(1, 6)]
    for target in targets:
        bench.send(pose(target))
        assert bench.step() == target


def pose_stream(bench):
    targets = [START - k * 1e-5 for k in range(1, 201)]  # 10 mm/s at 1 kHz
    for k in range(0, 200, 10):  # ten of them a tick: the last one counts
        for target in targets[k : k + 10]:
            bench.send(pose(target))
        assert bench.step() == targets[k + 9]


def stale(bench):
    bench.send(velocity(-3e-3))
    bench.step(50)
    at_timeout = bench.sim.plant.position[2]
    assert at_timeout == pytest.approx(START - 0.5 * 3e-3, abs=1e-12)
    assert bench.step(5) == at_timeout
    assert bench.sim.plant.commands.timed_out
    bench.send(velocity(-3e-3))
    assert bench.step() < at_timeout


def stamps(bench):
    for stamp in (0, 1, 2**31 - 1):
        before = bench.sim.plant.position[2]
        bench.send(velocity(-3e-3, stamp=stamp))
        assert bench.step() - before == pytest.approx(-3e-3 * DT, abs=1e-12)
    bench.send(velocity(-1e-3, stamp=5))
    before = bench.step()
    bench.send(velocity(3e-3, stamp=1))  # older by its stamp, newer by its arrival
    assert bench.step() > before


def wrong_frame(bench):
    bench.send(velocity(-3e-3, frame=""))  # no frame is the tissue frame
    bench.ignored(velocity(1.0, frame="needle_base"), "frame is not tissue")
    bench.ignored(pose(0.2, frame="map"), "frame is not tissue")


def not_finite(bench):
    bench.send(velocity(-3e-3))
    for bad in (math.nan, math.inf, -math.inf):
        bench.ignored(velocity(bad), "not finite")
        bench.ignored(velocity(0.0, turn=bad), "not finite")
        bench.ignored(pose(bad), "not finite")
        bench.ignored(pose(0.13, orientation=(1, 0, bad, 0)), "not finite")


def zero_quaternion(bench):
    bench.send(velocity(-3e-3))
    bench.ignored(pose(0.13, orientation=(0, 0, 0, 0)), "zero quaternion")
    turned = pose(0.13, orientation=(7.0, 0, 0, 0))  # any other length is normalised
    bench.send(turned)
    bench.step()
    assert bench.sim.plant.commands.rejected.total() == 1


def far_pose(bench):
    bench.send(velocity(-3e-3))
    bench.ignored(pose(1.0), "jump of more than 0.5 m")


def inadmissible(bench):
    bench.send(velocity(-3e-3, y=1e-3))
    assert bench.step(3) == START
    assert bench.sim.plant.commands.rejected["CommandError"] == 1


def unreadable(bench):
    bench.send(velocity(-3e-3))
    for data in (b"", b"\x00\x01\x00\x00", b"garbage" * 9):
        before = bench.step()
        bench.send(data, bench.poses)
        assert bench.step() - before == pytest.approx(-3e-3 * DT, abs=1e-12)
    assert bench.sim.plant.commands.rejected["unreadable"] == 3


def two_publishers(bench):
    other = bench.cell.publisher(TwistStamped, "/stage_velocity")
    for _ in range(3):
        before = bench.sim.plant.position[2]
        bench.send(velocity(-3e-3))
        bench.send(velocity(1e-3), other)
        assert bench.step() - before == pytest.approx(1e-3 * DT, abs=1e-12)
        before = bench.sim.plant.position[2]
        bench.send(velocity(1e-3), other)
        bench.send(velocity(-3e-3))
        assert bench.step() - before == pytest.approx(-3e-3 * DT, abs=1e-12)


def both_topics(bench):
    bench.send(velocity(3e-3))
    bench.send(pose(START - 1e-4))
    assert bench.step() == START - 1e-4
    bench.send(pose(START - 1e-3))
    bench.send(velocity(3e-3))
    assert bench.step() == pytest.approx(START - 1e-4 + 3e-3 * DT, abs=1e-12)


ROWS = {
    "a velocity": velocity_held,
    "a velocity beyond the limits": velocity_too_fast,
    "a pose, far from where the base is (a step)": pose_step,
    "poses along a ramp": pose_ramp,
    "a stream of poses at 1 kHz": pose_stream,
    "nothing for `command_timeout`": stale,
    "stamps in the past or the future": stamps,
    "another frame than `tissue_frame`": wrong_frame,
    "NaN or infinity": not_finite,
    "a zero quaternion": zero_quaternion,
    "a pose farther than `max_base_jump`": far_pose,
    "out of the plane of a 2D scene, into the tissue, …": inadmissible,
    "bytes that are no message": unreadable,
    "two publishers that disagree": two_publishers,
    "both topics at once": both_topics,
}


@pytest.mark.parametrize("row", ROWS)
def test_the_table_says_what_happens(cell, row):
    ROWS[row](Bench(cell))


def test_the_table_has_these_rows():
    text = PAGE.read_text(encoding="utf-8")
    table = text.split("## What a command does\n")[1].split("\n\n")[0]
    rows = [line.split("|")[1].strip() for line in table.splitlines()[2:]]
    assert rows == list(ROWS)


def test_a_stream_at_1_khz_in_real_time_ends_where_it_ends(cell):
    bench = Bench(cell, command_timeout=0.0)
    assert cell.call(SetBool, "/needle_sim/pause", data=False).success
    begin = time.monotonic()
    for k in range(1, 301):
        bench.poses.publish(pose(START - k * 1e-5))
        while time.monotonic() < begin + k * 1e-3:
            time.sleep(2e-4)
    cell.until(lambda: bench.sim.plant.position[2] == START - 300 * 1e-5)
    assert bench.sim.plant.commands.rejected_count == 0


def drive(bench, pace):
    """Step through both kinds of commands; return the raw bytes of every topic."""
    from rosgraph_msgs.msg import Clock

    topics = {"/base_wrench": WrenchStamped, "/clock": Clock, "/tip_pose": PoseStamped}
    heard = {name: bench.cell.collect(kind, name, raw=True) for name, kind in topics.items()}
    for k in range(40):
        if k % 8 == 0:
            bench.send(pose(START - 2e-4 * k) if k % 16 else velocity(-0.01 + 1e-4 * k))
        pace(k)
        bench.step()
    bench.cell.until(lambda: all(len(found) == 40 for found in heard.values()))
    return {name: [bytes(data) for data in found] for name, found in heard.items()}


def test_slower_and_faster_give_the_same_bits_and_a_truthful_clock(cell):
    bench = Bench(cell, publish_clock=True, command_timeout=0.06)
    fast = drive(bench, lambda k: None)
    clocks = [int(np.frombuffer(data[4:12], "<i4,<u4")[0][1]) for data in fast["/clock"]]
    assert clocks == [round((k + 1) * DT * 1e9) for k in range(40)]
    bench.sim.plant.reset()

    def pause_and_go(k):  # stop and start the clock, wait now and then
        if k % 10 == 5:
            time.sleep(0.02)
        assert bench.cell.call(SetBool, "/needle_sim/pause", data=True).success

    slow = drive(bench, pause_and_go)
    assert slow == fast
    assert bench.sim.plant.commands.timeouts > 0
