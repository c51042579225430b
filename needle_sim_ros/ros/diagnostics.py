# SPDX-License-Identifier: Apache-2.0
"""What `/diagnostics` says: whether the rate is held, commands arrive, the recording goes on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from needle_sim_ros.interaction import compiled_balance
from needle_sim_ros.ros.clock_loop import ClockLoop
from needle_sim_ros.ros.plant import Plant


class Diagnostics:
    """Makes diagnostics from what changed since the last time.

    Parameters
    ----------
    plant : Plant
        What ticks.
    loop : ClockLoop
        What makes it tick.
    publishers : callable
        Gives the number of publishers of each command topic.
    priority : callable
        Says with which priority the loop runs.
    name : str
        Name of the node.
    """

    def __init__(
        self,
        plant: Plant,
        loop: ClockLoop,
        publishers: Callable[[], Mapping[str, int]],
        priority: Callable[[], str],
        name: str,
    ) -> None:
        self._plant = plant
        self._publishers = publishers
        self._priority = priority
        self._loop = loop
        self._name = name
        self._seen = {"overruns": 0, "rejected": 0, "failed": 0, "lost": 0}
        self._wall = time.monotonic()
        self._ticks: int | None = None

    def message(self, pause: Callable[[], object] = lambda: None) -> DiagnosticArray:
        """Return the message, made with pauses; rates are since the last call."""
        message = DiagnosticArray()
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(self._plant.stamp, 1_000_000_000)
        for part in (self._clock, self._commands, self._recorder):
            message.status.append(part())
            pause()
        return message

    def _clock(self) -> DiagnosticStatus:
        plant, report = self._plant, self._loop.report()
        wall, ticks = time.monotonic(), plant.total_ticks
        ticked = ticks - (self._ticks or 0)
        factor = ticked * plant.period / max(wall - self._wall, 1e-9)
        level, text = DiagnosticStatus.OK, "paused" if self._loop.paused else "running"
        if not ticked and self._ticks is not None and not self._loop.paused:
            level, text = DiagnosticStatus.WARN, "no tick since the last report"
        self._wall, self._ticks = wall, ticks
        if self._rose("overruns", report.overruns):
            level, text = DiagnosticStatus.WARN, "the rate is not held"
        if self._rose("failed", plant.failed_ticks):
            level, text = DiagnosticStatus.ERROR, f"ticks fail: {plant.last_failure}"
        values = {
            "real_time_factor": f"{factor:.3f}",
            "rate_hz": f"{1 / plant.period:g}",
            "tick_p50_ms": f"{1e3 * report.tick_p50:.3f}",
            "tick_p99_ms": f"{1e3 * report.tick_p99:.3f}",
            "tick_max_ms": f"{1e3 * report.tick_max:.3f}",
            "lateness_p50_ms": f"{1e3 * report.lateness_p50:.3f}",
            "lateness_p99_ms": f"{1e3 * report.lateness_p99:.3f}",
            "lateness_max_ms": f"{1e3 * report.lateness_max:.3f}",
            "overruns": str(report.overruns),
            "ticks": str(ticks),
            "priority": self._priority(),
            "solves": str(plant.statistics.solves),
            "failed_ticks": str(plant.failed_ticks),
            "waits_for_solves": str(plant.waits),
            "prepared_beside_the_plan": f"{plant.prepared_beside:.0%}",
            "factorization": plant.factorization,
            "compiled": "yes" if compiled_balance.available() else "no",
            "simulated_time_s": f"{plant.time:.6f}",
        }
        return self._status("clock loop", level, text, values)

    def _commands(self) -> DiagnosticStatus:
        commands = self._plant.commands
        age = commands.age(self._plant.time)
        rejected = commands.rejected_count
        level, text = DiagnosticStatus.OK, "none received" if age is None else "received"
        if commands.timed_out:
            text = "timed out: the stage stands still"
        if self._rose("rejected", rejected):
            level, text = DiagnosticStatus.WARN, "commands are rejected"
        values = {
            "command_age_s": "" if age is None else f"{age:.3f}",
            "commands_received": str(commands.received),
            "commands_rejected": str(rejected),
            "command_timeouts": str(commands.timeouts),
            **{f"publishers: {topic}": str(n) for topic, n in self._publishers().items()},
            **{f"rejected: {reason}": str(n) for reason, n in sorted(commands.rejected.items())},
        }
        return self._status("commands", level, text, values)

    def _recorder(self) -> DiagnosticStatus:
        folder, status = self._plant.recording, self._plant.recorder_status
        level, text = DiagnosticStatus.OK, "off" if folder is None else "recording"
        if self._rose("lost", status.lost):
            level, text = DiagnosticStatus.ERROR, f"messages are lost: {status.error}"
        values = {
            "folder": str(folder or ""),
            "bytes": str(status.size),
            "messages": str(status.written),
            "queued": str(status.queued),
            "lost": str(status.lost),
            "error": status.error,
        }
        return self._status("recorder", level, text, values)

    def _rose(self, name: str, count: int) -> bool:
        before, self._seen[name] = self._seen[name], count
        return count > before

    def _status(
        self, part: str, level: bytes, text: str, values: Mapping[str, str]
    ) -> DiagnosticStatus:
        pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
        return DiagnosticStatus(
            level=level, name=f"{self._name}: {part}", message=text, values=pairs
        )
