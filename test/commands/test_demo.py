# SPDX-License-Identifier: Apache-2.0
"""``needle_sim demo``: two processes, real topics, the same result each time."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from needle_sim_ros.cli import main
from needle_sim_ros.session.reader import read_session

pytest.importorskip("rclpy")

_COMMAND = [sys.executable, "-m", "needle_sim_ros.cli", "demo"]


def _nodes(folder: Path) -> list[int]:
    """Return the ids of the node processes of the demo that writes to a folder."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"needle_sim_ros.ros.node" in words and any(str(folder).encode() in w for w in words):
            found.append(int(entry.name))
    return found


def _start(coarse, folder, *options):
    return subprocess.Popen(
        [*_COMMAND, "--output", f"{folder}", *coarse, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "ROS_LOG_DIR": f"{folder}/log"},
    )


def test_demo_gives_what_the_simulator_gives(recorded, coarse, tmp_path, capsys):
    """Not a bit may be lost, doubled or late on the way over the topics."""
    result = tmp_path / "demo.json"
    assert main(["demo", "--output", f"{tmp_path}", *coarse, "--json", f"{result}"]) == 0
    printed = capsys.readouterr().out
    told = json.loads(result.read_text())
    for words in (
        "peak base force, insertion",
        "bag:",
        "plot:",
        "try next:",
        "needle_sim plot",
        "report.html",
    ):
        assert words in printed
    assert Path(told["plot"]).read_bytes().startswith(b"\x89PNG")
    demo, run = read_session(told["bag"]), read_session(recorded / "bag")
    assert demo.complete
    assert [motion for _, motion in demo.motions] == [motion for _, motion in run.motions]
    for name in (
        "time",
        "insertion_depth",
        "base_force",
        "base_torque",
        "tip_position",
        "tip_deflection",
        "marker_displacements",
        "friction_force",
        "tip_force",
    ):
        assert np.array_equal(getattr(demo.series, name), getattr(run.series, name)), name
    assert demo.series.process == run.series.process
    assert len(demo.inputs) < 12  # what changed was sent, and arrived
    assert _nodes(tmp_path) == []


def test_realtime_lets_the_nodes_clock_run(coarse, tmp_path):
    short = ["--set", "protocol=[{duration: 1.5, velocity: [0, 0, -0.03]}, {duration: 0.5}]"]
    process = _start(coarse, tmp_path, *short, "--realtime", "--json", f"{tmp_path}/demo.json")
    _, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    session = read_session(json.loads((tmp_path / "demo.json").read_text())["bag"])
    moved = [motion.linear == (0.0, 0.0, -0.03) for _, motion in session.motions]
    depth = -session.series.tip_position[-1, 2]
    assert depth == pytest.approx(0.03 * 0.02 * sum(moved) - 0.01, abs=1e-9)
    # 75 ticks by the clock; on a busy machine some are missed, and never made up for
    assert 40 <= sum(moved) <= 90
    assert len(moved) <= 130
    assert len(session.inputs) > 30
    assert _nodes(tmp_path) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_node_ends_with_the_demo(coarse, tmp_path, number):
    process = _start(coarse, tmp_path, "--realtime")
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("gao2016_*")) and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    assert len(_nodes(tmp_path)) >= 1
    time.sleep(0.5)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "needle_sim: interrupted\n")
    assert _nodes(tmp_path) == []
    (bag,) = tmp_path.glob("gao2016_*")
    assert read_session(bag).complete  # the node finished its recording


def test_a_node_that_cannot_start_is_an_error_with_its_reason(coarse, tmp_path):
    odd = ["--set", "solver.time_step=2e-5", "--set", "protocol=[{duration: 0.01}]"]
    process = _start(coarse, tmp_path, *odd)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "rate" in err and err.count("\n") == 1
    assert _nodes(tmp_path) == []
