# SPDX-License-Identifier: Apache-2.0
"""The access policy fits what the node exposes, and nothing that comes in is executed."""

import random
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import PoseStamped, TwistStamped
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.managed_node import ManagedSimNode
from needle_sim_ros.ros.soak.hostile import hostile_message
from needle_sim_ros.session import cdr

POLICY = Path(__file__).parents[2] / "config" / "sros2" / "policy.xml"


def allowed(enclave, kind, access):
    """Return the resolved names that an enclave may use, e.g. topics to publish."""
    root = ElementTree.parse(POLICY).getroot()
    (found,) = (e for e in root.iter("enclave") if e.get("path") == f"/needle_sim/{enclave}")
    names = set()
    for group in found.iter(kind):
        if group.get(access) == "ALLOW":
            names |= {item.text.strip() for item in group}
    return {f"/{n.replace('~', 'needle_sim')}" for n in names}


def test_the_policy_allows_the_node_what_it_does_and_nothing_else(cell):
    node = ManagedSimNode(
        context=cell.context,
        parameter_overrides=[
            Parameter("scene_overrides", value=cell.overrides),
            Parameter("publish_clock", value=True),
        ],
    )
    from needle_sim_ros.ros.simulation import Simulation

    simulation = Simulation(node)
    try:
        published = {
            name for name, _ in node.get_publisher_names_and_types_by_node("needle_sim", "/")
        }
        subscribed = {
            name for name, _ in node.get_subscriber_names_and_types_by_node("needle_sim", "/")
        }
        services = {name for name, _ in node.get_service_names_and_types_by_node("needle_sim", "/")}
    finally:
        simulation.destroy()
        node.destroy_node()
    assert published == allowed("node", "topics", "publish")
    assert subscribed | {"/clock"} == allowed("node", "topics", "subscribe")  # with use_sim_time
    assert services == allowed("node", "services", "reply")
    inputs = {"/base_pose", "/stage_velocity"}
    assert inputs <= allowed("stage", "topics", "publish")
    assert not inputs & allowed("observer", "topics", "publish")
    assert allowed("observer", "services", "request") == set()


@pytest.mark.parametrize(
    "text", ["!!python/object/apply:os.system ['true']", "!!python/name:os.system"]
)
def test_tags_in_overrides_are_refused(cell, text):
    with pytest.raises(NeedleSimError, match="not a YAML value"):
        cell.start(scene_overrides=f"tissue.youngs_modulus={text}")


def state(sim):
    plant = sim.plant
    return (
        plant.position,
        plant.ticks,
        plant.commands.motion(plant.position, (1.0, 0.0, 0.0, 0.0), plant.time, 0.01),
    )


def test_hostile_messages_over_topics_change_nothing(cell):
    sim = cell.start()
    publishers = {
        "base_pose": cell.publisher(PoseStamped, "/base_pose"),
        "stage_velocity": cell.publisher(TwistStamped, "/stage_velocity"),
    }
    message = TwistStamped()
    message.twist.linear.z = -3e-3
    cell.send(publishers["stage_velocity"], message)
    before, rng = state(sim), random.Random(7)

    @settings(max_examples=80, suppress_health_check=list(HealthCheck))
    @given(st.randoms(use_true_random=False))
    def provoke(chance):
        for source in (chance, rng):
            topic, data = hostile_message(source)
            cell.send(publishers[topic], data)
        assert state(sim) == before

    provoke()
    assert sim.plant.commands.rejected_count == sim.plant.commands.received - 1 >= 160
    assert cell.step()["ticks"] == 1


finite = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=60)
@given(st.text(max_size=12), st.tuples(*[finite] * 7), st.integers(0, 9), st.binary(max_size=12))
def test_the_fast_reader_agrees_with_the_real_one_or_says_nothing(frame, numbers, cut, more):
    message = PoseStamped()
    message.header.frame_id = frame.encode("utf-8", "ignore").decode().replace("\0", "")
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z, q.x, q.y, q.z, q.w = numbers
    data = bytes(serialize_message(message))
    for changed in (data, data[: len(data) - cut], data + more, more + data):
        read = cdr.read_stamped_doubles(changed, 7)
        if read is None:
            continue
        real = deserialize_message(changed, PoseStamped)
        p, q = real.pose.position, real.pose.orientation
        assert read == (real.header.frame_id, (p.x, p.y, p.z, q.x, q.y, q.z, q.w))
    if message.header.frame_id.isascii():
        assert cdr.read_stamped_doubles(data, 7) is not None
