# SPDX-License-Identifier: Apache-2.0
"""Peers as processes, and what the system says about the node's process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import TracebackType

from needle_sim_ros.errors import NeedleSimError

_PATIENCE = 15.0  # s
_MIB = 1 << 20


class Peer:
    """A role of :mod:`needle_sim_ros.ros.soak.peer` in its own process, in a ``with`` block.

    Parameters
    ----------
    domain : int
        ROS domain id.
    file : Path
        What it writes at its end.
    role : str
    *topics : str
    """

    def __init__(self, domain: int, file: Path, role: str, *topics: str) -> None:
        self.file = file
        self._command = [
            sys.executable,
            "-m",
            "needle_sim_ros.ros.soak.peer",
            role,
            str(file),
            *topics,
        ]
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }

    def __enter__(self) -> Peer:
        self._process = subprocess.Popen(
            self._command,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            _, said = self._process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            _, said = self._process.communicate()
        if self._process.returncode and kind is None:
            lines = said.decode(errors="replace").strip().splitlines() or ["no message"]
            raise NeedleSimError(f"a peer of the soak ended: {lines[-1]}")


def resident_mb(pid: int) -> float:
    """Return the resident memory of a process, MiB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / _MIB


def open_files(pid: int) -> int:
    """Return the number of file descriptors of a process."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))
