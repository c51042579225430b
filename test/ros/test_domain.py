# SPDX-License-Identifier: Apache-2.0
"""A domain of one's own."""

import pytest

from needle_sim_ros.ros.domain import DOMAINS, free_domain


def test_a_domain_with_a_node_in_it_is_not_free(monkeypatch):
    rclpy = pytest.importorskip("rclpy")
    domain = free_domain()
    assert domain in DOMAINS
    context = rclpy.Context()
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("occupant", context=context)
    try:
        assert free_domain() != domain
    finally:
        node.destroy_node()
        context.try_shutdown()
