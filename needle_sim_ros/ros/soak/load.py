# SPDX-License-Identifier: Apache-2.0
"""The node at its rate for minutes: recorded, commanded at 1 kHz, listened to; then abused."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.ros.node_process import NodeProcess
from needle_sim_ros.ros.soak.host import Reading, Undisturbed, stolen_time, undisturbed
from needle_sim_ros.ros.soak.peer import HALF_PERIOD
from needle_sim_ros.ros.soak.processes import Peer, open_files, resident_mb
from needle_sim_ros.ros.soak.watch import Watch
from needle_sim_ros.session.reader import read_session

_WARM = 5.0  # s before memory and overruns count
PRIORITY = 20.0  # of the clock loop, where the system permits it
_LATENCY = 15.0  # s of measuring the latency, at most
_LISTENERS = ("base_wrench", "tissue_markers")
_LATENCY_TOPICS = ("base_wrench", "~/applied_velocity")
_CROWD = (
    "base_wrench",
    "base_wrench",
    "tissue_markers",
    "tissue_markers",
    "tip_pose",
    "tip_deflection",
    "insertion_depth",
    "process",
    "~/stage_pose",
)  # and one that stalls: ten


@dataclass
class Load:
    """What was measured; times in s, memory in MiB."""

    ticks: int = 0
    overruns: int = 0
    crowd_ticks: int = 0
    crowd_overruns: int = 0
    lost: int = 0
    gaps: int = 0
    rss_growth: float = 0.0
    rss_growth_after_stroke: float | None = None
    files_growth: int = 0
    cycles: int = 0
    latencies: list[float] = field(default_factory=list)
    tick_p50: float = 0.0
    tick_p99: float = 0.0
    lateness_p99: float = 0.0
    realtime: bool = False
    undisturbed: Undisturbed = field(default_factory=Undisturbed)


def load(
    parameters: dict[str, object],
    domain: int,
    place: Path,
    steady: float,
    crowd: float,
    cycles: int,
    advance: Callable[[float], object],
) -> Load:
    """Run the node under load.

    Parameters
    ----------
    parameters : dict
        Of the node; it records into a folder of `place`.
    domain : int
        ROS domain id.
    place : Path
        For logs, sessions and what the peers write.
    steady : float
        With recording and two subscribers, s.
    crowd : float
        With ten subscribers of which one stalls, hostile publishers that come and go, and
        recordings that start and stop, s.
    cycles : int
        Starts and stops of the recording.
    advance : callable
        Told of seconds that have passed.
    """
    result = Load()
    bags = place / "bags"
    with ExitStack() as stack:
        given = {**parameters, "record_root": str(bags), "realtime_priority": PRIORITY}
        node = stack.enter_context(NodeProcess(given, domain, place / "load.log"))
        watch = stack.enter_context(Watch(domain, node.check))
        watch.wait_ready()
        commander = Peer(domain, place / "sent", "commander")
        with commander:
            with Peer(domain, place / "heard", "subscribers", *_LISTENERS):
                folder = Path(watch.record(True))
                watch.wait_heard(_LISTENERS[-1])
                _pass(watch, _WARM, advance)
                before, memory, files = _state(watch, node.pid)
                readings, settled = _readings(watch, node.pid, steady, advance)
                result.undisturbed = undisturbed(readings)
                after, memory_after, _ = _state(watch, node.pid)
                result.ticks, result.overruns = _ticks(before, after)
                result.rss_growth = memory_after - memory
                if settled is not None:
                    result.rss_growth_after_stroke = memory_after - settled
                result.tick_p50 = float(after["tick_p50_ms"]) * 1e-3
                result.tick_p99 = float(after["tick_p99_ms"]) * 1e-3
                result.lateness_p99 = float(after["lateness_p99_ms"]) * 1e-3
                result.realtime = after["priority"].startswith("SCHED_FIFO")
                result.lost += int(watch.diagnostics()["lost"])
                said = watch.record(False)
                if " lost: " in said and not result.lost:
                    raise NeedleSimError(f"recording {said}")
            with Peer(domain, place / "latency", "subscribers", *_LATENCY_TOPICS):
                watch.wait_heard(_LATENCY_TOPICS[-1])
                _pass(watch, min(_LATENCY, max(3.0, steady / 4)), advance)
            _crowd(watch, domain, place, crowd, cycles, result, advance)
        after, _, files_after = _state(watch, node.pid)
        result.files_growth = files_after - files
    result.latencies = _latencies(place)
    result.gaps = _gaps(folder, 1.0 / float(str(parameters["rate"])))
    return result


def _crowd(
    watch: Watch,
    domain: int,
    place: Path,
    duration: float,
    cycles: int,
    result: Load,
    advance: Callable[[float], object],
) -> None:
    with (
        Peer(domain, place / "crowd", "subscribers", *_CROWD),
        Peer(domain, place / "stalled", "stalling", "base_wrench"),
        Peer(domain, place / "hostile", "hostile"),
    ):
        before = watch.diagnostics()
        begin = time.monotonic()
        while time.monotonic() - begin < duration or result.cycles < cycles:
            if result.cycles < cycles:
                watch.record(True)
                watch.spin(0.05)
                result.lost += " lost: " in watch.record(False)
                result.cycles += 1
            now = time.monotonic() - begin
            pause = duration * result.cycles / max(1, cycles) - now if cycles else duration - now
            _pass(watch, min(1.0, max(0.0, pause)), advance)
        result.crowd_ticks, result.crowd_overruns = _ticks(before, watch.diagnostics())


def _pass(watch: Watch, duration: float, advance: Callable[[float], object]) -> None:
    end = time.monotonic() + duration
    while (left := end - time.monotonic()) > 0:
        watch.spin(min(1.0, left))
        advance(min(1.0, left))


def _readings(
    watch: Watch, pid: int, duration: float, advance: Callable[[float], object]
) -> tuple[list[Reading], float | None]:
    """Let a time pass; return what each of the node's diagnostics in it said.

    And its memory after the first stroke in and out, MiB, None where that does not end.
    """
    readings: list[Reading] = []
    settled: float | None = None
    begin = now = time.monotonic()
    while now < begin + duration:
        said = watch.diagnostics()
        before, now = now, time.monotonic()
        readings.append(Reading(now, int(said["ticks"]), int(said["overruns"]), stolen_time()))
        if settled is None and now >= begin + 2 * HALF_PERIOD:
            settled = resident_mb(pid)
        advance(now - before)
    return readings, settled


def _state(watch: Watch, pid: int) -> tuple[dict[str, str], float, int]:
    return watch.diagnostics(), resident_mb(pid), open_files(pid)


def _ticks(before: dict[str, str], after: dict[str, str]) -> tuple[int, int]:
    names = ("ticks", "overruns")
    ticks, overruns = (int(after[name]) - int(before[name]) for name in names)
    return ticks, overruns


def _latencies(place: Path) -> list[float]:
    """Return the times from a command's sending to the wrench of the tick that obeyed it, s."""
    data = (place / "sent").read_bytes()
    sent = struct.unpack(f"<{len(data) // 8}d", data)
    first: dict[int, float] = {}
    for line in (place / "latency").read_text(encoding="utf-8").splitlines():
        mark, *values = line.split()
        if mark == "!":
            tag, arrived = int(values[0]), float(values[1])
            if 0 < tag < len(sent):  # tag 0 is a stage that stands still
                first[tag] = min(arrived, first.get(tag, arrived))
    return [arrived - sent[tag] for tag, arrived in first.items()]


def _gaps(folder: Path, period: float) -> int:
    """Return how many ticks are missing in a session between its first and its last."""
    times = read_session(folder).series.time
    if not len(times):
        return 0
    return round(float(times[-1] - times[0]) / period) + 1 - len(np.unique(times))
