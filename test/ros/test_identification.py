# SPDX-License-Identifier: Apache-2.0
"""Online identification over real topics, and nothing of it when it is off."""

import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped, WrenchStamped
from sensor_msgs.msg import PointCloud2


def test_it_costs_nothing_when_off(cell):
    sim = cell.start()
    assert sim.plant.watch is None
    topics = dict(sim.get_topic_names_and_types())
    assert "/measured_wrench" not in topics and "/identified_parameters" not in topics


def test_measurements_in_parameters_out(cell):
    sim = cell.start(paused=True, identify=True)
    found = cell.collect(DiagnosticArray, "/identified_parameters")
    wrench = cell.publisher(WrenchStamped, "/measured_wrench")
    markers = cell.publisher(PointCloud2, "/measured_markers")
    # the simulated outputs come back as measurements, as a force sensor would send them
    cell.peer.create_subscription(WrenchStamped, "/base_wrench", wrench.publish, 100)
    cell.peer.create_subscription(PointCloud2, "/tissue_markers", markers.publish, 100)
    down = TwistStamped()
    down.header.frame_id, down.twist.linear.z = "tissue", -0.01
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), down)
    sim.loop.resume()
    cell.until(lambda: sim.plant.time > 1.5, "15 mm of motion")
    sim.loop.pause()  # the estimator may lag on a busy machine: it catches up

    def values():
        status = found[-1].status[0] if found else None
        known = {v.key: v.value for v in status.values} if status is not None else {}
        error = float(known.get("youngs_modulus.standard_error", "inf"))
        return known if error < 1500 else None

    known = cell.until(values, "modulus known to 10 %")
    assert float(known["youngs_modulus"]) == pytest.approx(15e3, rel=0.1)
    assert known["friction.kinetic.unit"] == "N/m" and known["ignored_measurements"] == "0"
    assert found[-1].status[0].level == DiagnosticStatus.OK
    wrong = PointCloud2()
    markers.publish(wrong)
    cell.until(
        lambda: any(v.value == "1" for v in found[-1].status[0].values if "ignored" in v.key)
    )


def test_estimates_are_applied_when_asked(cell):
    """A sensor that reads 1.3 times the simulated force: friction rises by itself."""
    sim = cell.start(paused=True, identify=True, identify_apply=True)
    wrench = cell.publisher(WrenchStamped, "/measured_wrench")

    def stronger(message):
        for axis in "xyz":
            setattr(message.wrench.force, axis, 1.3 * getattr(message.wrench.force, axis))
        wrench.publish(message)

    cell.peer.create_subscription(WrenchStamped, "/base_wrench", stronger, 100)
    down = TwistStamped()
    down.header.frame_id, down.twist.linear.z = "tissue", -0.01
    cell.send(cell.publisher(TwistStamped, "/stage_velocity"), down)
    name = "interaction.friction.kinetic"
    before = sim.get_parameter(name).value
    sim.loop.resume()
    cell.until(lambda: sim.plant.time > 2.0, "20 mm of motion")
    sim.loop.pause()
    cell.until(lambda: sim.get_parameter(name).value > 1.05 * before, "friction applied")
