# SPDX-License-Identifier: Apache-2.0
"""The soak as a command: what it starts goes with it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

PATIENCE = 100.0  # s


def processes(folder):
    """Return the command lines of processes that name a folder."""
    found = []
    for each in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = each.read_bytes()
        except OSError:  # it has ended
            continue
        if os.fsencode(folder) in line:
            found.append(line)
    return found


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.05)


def test_it_leaves_no_process_behind_when_it_is_terminated(tmp_path):
    command = [sys.executable, "-m", "needle_sim_ros.cli", "benchmark", "soak", "--quick"]
    with subprocess.Popen(
        command,
        env={**os.environ, "TMPDIR": str(tmp_path)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as soak:
        wait_until(lambda: any(b"needle_sim_ros.ros.node" in line for line in processes(tmp_path)))
        soak.send_signal(signal.SIGTERM)
        assert soak.wait(PATIENCE) != 0
    wait_until(lambda: not processes(tmp_path))
    assert not list(tmp_path.glob("needle_sim_soak_*"))
