# SPDX-License-Identifier: Apache-2.0
"""The node as a process of its own that is always ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from needle_sim_ros.errors import NeedleSimError

_PATIENCE = ((signal.SIGINT, 10.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))  # s


class NodeProcess:
    """Runs the node while a ``with`` block runs; ends it however the block ends.

    Parameters
    ----------
    parameters : mapping of str to bool, float or str
        Parameters of the node.
    domain : int
        ROS domain id.
    log : Path
        Takes what the node writes to stdout and stderr.
    """

    def __init__(self, parameters: Mapping[str, object], domain: int, log: Path) -> None:
        self._command = [sys.executable, "-m", "needle_sim_ros.ros.node", "--ros-args"]
        for name, value in parameters.items():
            # JSON is YAML, in which parameters are written, with every string quoted.
            self._command += ["-p", f"{name}:={json.dumps(value)}"]
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONUNBUFFERED": "1",
        }
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> NodeProcess:
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                self._command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches it through stop() only, and once
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """Process id."""
        if self._process is None:
            raise NeedleSimError("the node was not started")
        return self._process.pid

    def end(self, number: signal.Signals, patience: float) -> tuple[int | None, float]:
        """Send a signal; return the exit status, None if it lives on, and how long it took, s."""
        process = self._process
        if process is None:
            raise NeedleSimError("the node was not started")
        begin = time.monotonic()
        process.send_signal(number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(patience)
        return process.poll(), time.monotonic() - begin

    def check(self) -> None:
        """Raise `NeedleSimError` with the node's last words if it has ended."""
        process = self._process
        if process is None or process.poll() is None:
            return
        lines = self._log.read_text(encoding="utf-8", errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "no message")
        raise NeedleSimError(f"the node ended with status {process.returncode}: {last}")

    def stop(self) -> int | None:
        """End the node, gently first; return its exit status, None if it never ran."""
        process = self._process
        if process is None:
            return None
        for number, patience in _PATIENCE:
            if process.poll() is not None:
                break
            process.send_signal(number)
            try:
                process.wait(patience)
            except subprocess.TimeoutExpired:
                continue
            except KeyboardInterrupt:  # a second Ctrl-C: no more patience
                process.kill()
                process.wait()
                raise
        return process.poll()
