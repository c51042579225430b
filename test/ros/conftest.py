# SPDX-License-Identifier: Apache-2.0
"""A cell of the simulator node and a peer, each with its own executor, talking over DDS."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"

DEADLINE = 30.0
# gao2016 on a coarse mesh: these tests are about messages, not about accuracy.
COARSE = {
    "solver.dynamics": "quasi_static",
    "solver.track_spacing": 4.0e-3,
    "tissue.mesh.element": "quad1",
    "tissue.mesh.spacing_across": 2.0e-3,
    "tissue.mesh.spacing_along": 4.0e-3,
    "markers": [[0.0, 0.0, -0.01], [0.005, 0.0, -0.02], [-0.005, 0.0, -0.03]],
    "base.position": [0.0, 0.0, 0.1302],
}
OVERRIDES = "; ".join(f"{key}={json.dumps(value)}" for key, value in COARSE.items())
_domains = itertools.count(os.getpid())


def until(condition, what="condition"):
    """Wait for a condition; fail when it takes longer than the deadline."""
    end = time.monotonic() + DEADLINE
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < end, f"{what} not met within {DEADLINE} s"
        time.sleep(0.005)


@pytest.fixture(autouse=True)
def _log_folder(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path_factory.getbasetemp() / "log"))


@pytest.fixture
def domain():
    """Return a domain id of this test's own."""
    return 1 + next(_domains) % 100  # higher ones need ports that may be taken


class Cell:
    """A context with a peer node and, once started, the simulator node."""

    until = staticmethod(until)
    scene_changes = COARSE
    overrides = OVERRIDES

    def __init__(self, domain):
        import rclpy
        from rclpy.context import Context

        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.peer = rclpy.create_node("peer", context=self.context)
        self.spinners = []
        self.spin(self.peer)
        self.sim = None
        self.clients = {}

    def spin(self, node):
        """Spin a node in a thread of its own until the cell is closed."""
        from needle_sim_ros.ros.spinning import Spinning

        self.spinners.append(Spinning(node, "executor"))

    def start(self, paused=True, arguments=(), **parameters):
        """Start the simulator node; parameters' dots are written as double underscores.

        `arguments` are those after --ros-args.
        """
        from rclpy.parameter import Parameter

        from needle_sim_ros.ros.sim_node import SimNode

        given = {} if arguments else {"scene_overrides": OVERRIDES, "command_timeout": 0.0}
        given.update(parameters)
        overrides = [Parameter(k.replace("__", "."), value=v) for k, v in given.items()]
        cli_args = ["--ros-args", *arguments] if arguments else None
        self.sim = SimNode(context=self.context, parameter_overrides=overrides, cli_args=cli_args)
        self.spin(self.sim)
        if paused:
            self.sim.loop.pause()
        self.sim.start()
        return self.sim

    def collect(self, kind, topic, raw=False):
        """Return a list that fills with the messages of a topic, from now on."""
        messages = []
        subscription = self.peer.create_subscription(kind, topic, messages.append, 1000, raw=raw)
        until(lambda: subscription.get_publisher_count(), f"publisher of {topic}")
        if self.sim is not None:
            name = subscription.topic_name
            for channel, sink in self.sim.sinks.items():
                if self.sim.resolve_topic_name(channel.name) == name:
                    until(partial(getattr, sink, "wanted"), f"subscriber of {topic}")
        return messages

    def priority(self, word):
        """Return what /diagnostics says of the clock loop's priority, once a word is in it."""
        from diagnostic_msgs.msg import DiagnosticArray

        arrays = self.collect(DiagnosticArray, "/diagnostics")

        def said():
            return [
                pair.value
                for array in arrays
                for status in array.status
                for pair in status.values
                if pair.key == "priority" and word in pair.value
            ]

        return self.until(said, f"{word} in /diagnostics")[0]

    def publisher(self, kind, topic):
        """Return a publisher that the simulator node hears."""
        publisher = self.peer.create_publisher(kind, topic, 1000)
        until(publisher.get_subscription_count, f"subscriber of {topic}")
        return publisher

    def send(self, publisher, message):
        """Publish a command until the simulator has received it."""
        before = self.sim.plant.commands.received
        publisher.publish(message)
        until(lambda: self.sim.plant.commands.received > before, "command received")

    def call(self, kind, name, **request):
        """Call a service and return its response."""
        if name not in self.clients:
            self.clients[name] = self.peer.create_client(kind, name)
            assert self.clients[name].wait_for_service(DEADLINE)
        future = self.clients[name].call_async(kind.Request(**request))
        until(future.done, f"answer of {name}")
        return future.result()

    def step(self, times=1):
        """Step the paused simulator; return the status after the last step."""
        from std_srvs.srv import Trigger

        for _ in range(times):
            response = self.call(Trigger, "/needle_sim/step")
            assert response.success, response.message
        return json.loads(response.message)

    def close(self):
        import rclpy

        if self.sim is not None:
            self.sim.close()
        for spinner in self.spinners:
            spinner.stop()
        for node in (self.peer, self.sim):
            if node is not None:
                node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def cell(domain):
    """Return a cell whose simulator is not started yet."""
    pytest.importorskip("rclpy")
    cell = Cell(domain)
    yield cell
    cell.close()


class NodeProcess:
    """The node in a process of its own, as `ros2 run` starts it."""

    until = staticmethod(until)

    def __init__(self, domain, folder, *arguments, managed=False, environment=None):
        self.folder = Path(folder)
        command = [sys.executable, "-m", "needle_sim_ros.ros.node"]
        command += ["--managed"] if managed else []
        command += ["--ros-args"]
        for argument in (f"scene_overrides:={json.dumps(OVERRIDES)}", *arguments):
            command += ["-p", argument]
        self.log = (self.folder / "node.log").open("w+")
        self.process = subprocess.Popen(
            command,
            stdout=self.log,
            stderr=subprocess.STDOUT,
            env={
                **os.environ,
                "ROS_DOMAIN_ID": str(domain),
                "PYTHONUNBUFFERED": "1",
                **(environment or {}),
            },
        )

    def output(self):
        return (self.folder / "node.log").read_text()

    def until_running(self):
        """Wait until the node ticks; fail with its output when it ends before."""

        def running():
            assert self.process.poll() is None, self.output()
            return "simulating gao2016" in self.output()

        until(running, "node running")

    def session(self):
        """Return the folder being recorded, once messages are in it."""

        def found():
            files = list(self.folder.glob("**/*.mcap"))
            return files[0].parent if files and files[0].stat().st_size > 40_000 else None

        return until(found, "recording")

    def end(self, number=signal.SIGTERM):
        """Send a signal; return the exit status and how long it took, s."""
        start = time.monotonic()
        self.process.send_signal(number)
        status = self.process.wait(DEADLINE)
        return status, time.monotonic() - start

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(DEADLINE)
        self.log.close()


@pytest.fixture
def node_process(domain, tmp_path):
    """Return a function that starts the node with parameters `name:=value`."""
    pytest.importorskip("rclpy")
    started = []

    def start(*arguments, folder=tmp_path, **options):
        started.append(NodeProcess(domain, folder, *arguments, **options))
        return started[-1]

    yield start
    for process in started:
        process.close()
