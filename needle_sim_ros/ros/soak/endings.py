# SPDX-License-Identifier: Apache-2.0
"""Nodes that are killed or told to end while they record; what is left of their sessions."""

from __future__ import annotations

import importlib.util
import random
import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from geometry_msgs.msg import WrenchStamped

from needle_sim_ros.errors import NeedleSimError, SessionError
from needle_sim_ros.ros.node_process import NodeProcess
from needle_sim_ros.ros.soak.watch import Watch
from needle_sim_ros.session.reader import mcap_files, read_session
from needle_sim_ros.session.salvage import salvage

_LEAST = 0.6  # s of simulated time to be recorded before the end
_PATIENCE = 20.0  # s
_STAMP = struct.Struct("<iI")


@dataclass
class Endings:
    """Losses and durations, s; how many sessions were whole afterwards."""

    losses: list[float] = field(default_factory=list)
    salvaged: int = 0
    durations: list[float] = field(default_factory=list)
    clean: int = 0


def end_nodes(
    parameters: dict[str, object],
    domain: int,
    place: Path,
    count: int,
    advance: Callable[[], object],
) -> Endings:
    """Start nodes that record, `count` to be killed and as many to be told to end.

    Parameters
    ----------
    parameters : dict
        Of the nodes.
    domain : int
        ROS domain id.
    place : Path
        For logs and sessions.
    count : int
        Of each kind.
    advance : callable
        Called after each.
    """
    result, rng = Endings(), random.Random(0)
    for number in range(2 * count):
        kill = number % 2 == 0
        own = place / f"end_{number}"
        own.mkdir()
        last = _Last()
        given = {**parameters, "record": str(own / "bags")}
        with (
            NodeProcess(given, domain, own / "node.log") as node,
            Watch(domain, node.check) as watch,
        ):
            watch.listen(WrenchStamped, "base_wrench", last.heard)
            least = _LEAST + rng.random()
            if not watch.until(partial(last.beyond, least), 6 * _PATIENCE):
                raise NeedleSimError("the node does not tick")
            how = signal.SIGKILL if kill else signal.SIGTERM
            status, took = node.end(how, _PATIENCE)
            watch.drain()
        (folder,) = (own / "bags").iterdir()
        if kill:
            result.losses.append(_loss(folder, own / "salvaged", last.time))
            result.salvaged += _whole(own / "salvaged")
        else:
            result.durations.append(took)
            result.clean += status == 0 and _whole(folder)
        advance()
    return result


class _Last:
    """Simulated time of the newest wrench that was heard, s."""

    def __init__(self) -> None:
        self.time = 0.0

    def heard(self, data: bytes) -> None:
        second, nanosecond = _STAMP.unpack_from(data, 4)
        self.time = second + 1e-9 * nanosecond

    def beyond(self, time: float) -> bool:
        return self.time > time


def _loss(folder: Path, target: Path, last: float) -> float:
    salvage(mcap_files(folder), target)
    times = read_session(target).series.time
    return last - (float(times[-1]) if len(times) else 0.0)


def _whole(folder: Path) -> bool:
    """Return whether a session is finished, and a reader that is not ours reads it too."""
    try:
        session = read_session(folder)
    except SessionError:
        return False
    if not session.complete:
        return False
    if importlib.util.find_spec("rosbags") is None:
        return True  # salvage has read it by the `mcap` package
    from rosbags.rosbag2 import Reader

    with Reader(folder) as reader:
        return sum(1 for _ in reader.messages()) == reader.message_count > 0
