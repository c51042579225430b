# SPDX-License-Identifier: Apache-2.0
"""The managed node through its real transitions, driven by the lifecycle services."""

import json

import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import TwistStamped, WrenchStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from needle_sim_ros.session.reader import read_session


@pytest.fixture
def managed(cell):
    """Return a function that makes the managed node in the cell, and one that changes its state."""
    from needle_sim_ros.ros.managed_node import ManagedSimNode

    def make(**parameters):
        given = {"scene_overrides": cell.overrides, "command_timeout": 0.0, **parameters}
        overrides = [Parameter(k.replace("__", "."), value=v) for k, v in given.items()]
        cell.managed = ManagedSimNode(context=cell.context, parameter_overrides=overrides)
        cell.spin(cell.managed)
        return cell.managed

    yield make
    for spinner in cell.spinners:
        spinner.stop()
    cell.managed.close()
    cell.managed.destroy_node()
    cell.spinners = []


def state(cell):
    return cell.call(GetState, "/needle_sim/get_state").current_state.id


def change(cell, transition):
    request = Transition(id=transition)
    return cell.call(ChangeState, "/needle_sim/change_state", transition=request).success


def test_it_builds_on_configure_ticks_while_active_and_can_be_brought_up_again(
    cell, managed, tmp_path
):
    node = managed(record=str(tmp_path))
    assert state(cell) == State.PRIMARY_STATE_UNCONFIGURED
    assert node.simulation is None
    assert cell.peer.get_publishers_info_by_topic("/base_wrench") == []
    assert not change(cell, Transition.TRANSITION_ACTIVATE)

    assert change(cell, Transition.TRANSITION_CONFIGURE)
    assert state(cell) == State.PRIMARY_STATE_INACTIVE
    plant = node.simulation.plant
    publisher = cell.publisher(TwistStamped, "/stage_velocity")
    wrenches = cell.collect(WrenchStamped, "/base_wrench")
    for kind, name, request in (
        (Trigger, "step", {}),
        (SetBool, "pause", {"data": False}),
    ):
        response = cell.call(kind, f"/needle_sim/{name}", **request)
        assert not response.success and "not active" in response.message
    assert plant.ticks == 0

    assert change(cell, Transition.TRANSITION_ACTIVATE)
    assert state(cell) == State.PRIMARY_STATE_ACTIVE
    message = TwistStamped()
    message.twist.linear.z = -3e-3
    publisher.publish(message)
    cell.until(lambda: len(wrenches) > 10 and plant.commands.received == 1)

    assert change(cell, Transition.TRANSITION_DEACTIVATE)
    cell.call(Trigger, "/needle_sim/reset")  # the executor is past the tick under way
    ticks = plant.total_ticks
    assert state(cell) == State.PRIMARY_STATE_INACTIVE
    assert change(cell, Transition.TRANSITION_ACTIVATE)
    cell.until(lambda: plant.total_ticks > ticks + 3)
    response = cell.call(SetBool, "/needle_sim/pause", data=True)
    assert response.success and json.loads(response.message)["paused"]
    assert cell.call(Trigger, "/needle_sim/step").success

    folder = plant.recording
    assert change(cell, Transition.TRANSITION_DEACTIVATE)
    assert change(cell, Transition.TRANSITION_CLEANUP)
    assert state(cell) == State.PRIMARY_STATE_UNCONFIGURED
    assert node.simulation is None
    session = read_session(folder)
    assert session.complete and len(session.series) > 10
    cell.until(lambda: not cell.peer.get_publishers_info_by_topic("/base_wrench"))

    assert change(cell, Transition.TRANSITION_CONFIGURE)
    assert node.simulation.plant is not plant
    assert node.simulation.plant.ticks == 0
    result = cell.call(
        SetParameters,
        "/needle_sim/set_parameters",
        parameters=[Parameter("max_base_speed", value=0.01).to_parameter_msg()],
    ).results[0]
    assert result.successful
    assert node.simulation.plant.commands.limits.speed == 0.01
    assert change(cell, Transition.TRANSITION_INACTIVE_SHUTDOWN)
    assert state(cell) == State.PRIMARY_STATE_FINALIZED


def test_a_configuration_that_cannot_work_leaves_it_unconfigured(cell, managed):
    node = managed(scene="gao2017")
    assert not change(cell, Transition.TRANSITION_CONFIGURE)
    assert state(cell) == State.PRIMARY_STATE_UNCONFIGURED
    assert node.simulation is None
    assert cell.peer.get_publishers_info_by_topic("/base_wrench") == []


@pytest.mark.parametrize("active", [False, True])
def test_a_signal_ends_the_process_with_status_0(cell, node_process, tmp_path, active):
    node = node_process(f"record:={tmp_path}", managed=True)
    if active:
        assert change(cell, Transition.TRANSITION_CONFIGURE)
        assert change(cell, Transition.TRANSITION_ACTIVATE)
        folder = node.session()
    else:
        assert state(cell) == State.PRIMARY_STATE_UNCONFIGURED
    status, _ = node.end()
    assert status == 0, node.output()
    assert "Traceback" not in node.output()
    if active:
        assert read_session(folder).complete
