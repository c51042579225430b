# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else on this machine is in."""

from __future__ import annotations

import os
import socket

from needle_sim_ros.errors import NeedleSimError

# Above 101 the ports fall into Linux' range of ephemeral ones; low ids are what people choose.
DOMAINS = range(30, 101)


def free_domain() -> int:
    """Return a domain id whose first participant's port is not in use.

    RTPS gives the first participant of domain d the UDP port 7410 + 250 d for
    discovery (DDSI-RTPS 2.5, section 9.6.2.3); where that is taken, somebody is there.

    Raises
    ------
    NeedleSimError
        When somebody is in every domain.
    """
    start = os.getpid()
    for offset in range(len(DOMAINS)):
        domain = DOMAINS[(start + offset) % len(DOMAINS)]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7410 + 250 * domain))
            except OSError:
                continue
            return domain
    raise NeedleSimError(f"every ROS domain from {DOMAINS[0]} to {DOMAINS[-1]} is in use")
