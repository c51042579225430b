# SPDX-License-Identifier: Apache-2.0
"""The speed benchmark measures what it says, on a scene small enough for a test."""

import json
import signal
import threading
import time

import pytest

from needle_sim_ros import Scene, Simulator
from needle_sim_ros.benchmark.profile import sampled
from needle_sim_ros.benchmark.speed import _Run, speed
from needle_sim_ros.protocol import protocol_commands

SMALL = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 4e-3,
    "protocol": [
        {"duration": 1.6, "velocity": [0.0, 0.0, -0.015]},
        {"duration": 0.4},
        {"duration": 0.8, "velocity": [0.0, 0.0, 0.015]},
    ],
}


@pytest.fixture(scope="module")
def measured():
    seen = []
    result = speed(Scene.load("gao2016", SMALL), progress=lambda *where: seen.append(where))
    return result, seen


def test_figures_have_the_names_that_others_read(measured):
    figures = measured[0].figures
    assert set(figures) == {
        "paper_over_tick_median",
        "tick_p99_over_median",
        "newmark_over_quasi_static",
        "reduced_over_quasi_static",
        "node_overrun_fraction",
        "unread_markers_over_none",
    }
    assert figures["node_overrun_fraction"] is None
    assert all(value > 0 for name, value in figures.items() if name != "node_overrun_fraction")
    assert figures["tick_p99_over_median"] >= 1
    assert json.loads(measured[0].to_json())["figures"] == pytest.approx(figures, nan_ok=True)


def test_every_run_makes_every_tick(measured):
    result, seen = measured
    ticks = [row for row in result.table if "run" in row]
    assert {row["ticks"] for row in ticks} == {280}
    assert seen[-1] == (280, 280)
    assert sorted(seen) == seen and len(seen) > 10
    own = [row for row in ticks if "the scene's own" in row["run"]]
    assert len(own) == 1
    paper = next(row for row in ticks if row["run"].startswith("paper"))
    assert paper["paper_over_it"] == 1
    ratio = paper["median_ms"] / own[0]["median_ms"]
    assert result.figures["paper_over_tick_median"] == pytest.approx(ratio)


def test_shares_of_the_tick_add_up(measured):
    parts = [row["share"] for row in measured[0].table if "share" in row]
    assert sum(parts) == pytest.approx(1.0)


def test_quick_goes_as_deep_in_an_eighth_of_the_ticks():
    changes = {**SMALL, "solver.dynamics": "quasi_static"}
    seen = []
    result = speed(Scene.load("gao2016", changes), quick=True, progress=lambda *w: seen.append(w))
    assert seen[-1] == (32, 32)
    own = next(row for row in result.table if "the scene's own" in row.get("run", ""))
    assert own["run"].startswith("quasi_static")
    assert own["median_inserted_ms"] > 0


def test_regions_leave_the_paper_out():
    region = {"name": "hard", "shape": "ellipsoid", "center": [0, 0, -0.03], "size": [0.01] * 3}
    changes = {**SMALL, "tissue.regions": [{**region, "youngs_modulus": 3e4}]}
    result = speed(Scene.load("gao2016", changes), quick=True)
    assert result.figures["paper_over_tick_median"] is None
    assert result.figures["newmark_over_quasi_static"] > 0


def test_node_is_measured_alone_recording_and_with_subscribers():
    asked = []

    def node(scene, record, subscribe):
        asked.append((scene.name, record, subscribe))
        return {"ticks": 200, "overruns": 3 * record, "median_ms": 0.5}

    scene = Scene.load("gao2016", SMALL | {"solver.dynamics": "quasi_static"})
    result = speed(scene, quick=True, node=node)
    assert asked == [("gao2016", False, False), ("gao2016", True, False), ("gao2016", True, True)]
    assert result.figures["node_overrun_fraction"] == 3 / 203
    rows = [row for row in result.table if "node" in row]
    paper = next(r for r in result.table if r.get("run", "").startswith("paper"))["median_ms"]
    assert [row["overruns"] for row in rows] == [0, 3, 3]
    assert rows[0]["paper_over_it"] == pytest.approx(paper / 0.5)


class TestProfile:
    def test_finds_the_functions_at_work(self):
        scene = Scene.load("gao2016", SMALL | {"solver.dynamics": "quasi_static"})
        simulator = Simulator(scene)
        with sampled() as counts:
            until = time.process_time() + 0.5
            while time.process_time() < until:
                simulator.reset()
                for command in protocol_commands(scene.protocol, 0.01):
                    simulator.step(command, 0.01)
        assert sum(counts.values()) > 20
        places = {label.split("/")[0].split(".py")[0] for label in counts}
        assert "interaction" in places
        assert not any(label.startswith("benchmark") for label in counts)

    def test_leaves_the_timer_off_and_the_handler_as_it_was(self):
        before = signal.getsignal(signal.SIGPROF)
        with pytest.raises(ZeroDivisionError), sampled():
            1 / 0  # noqa: B018
        assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
        assert signal.getsignal(signal.SIGPROF) is before

    def test_another_thread_gets_no_samples(self):
        found = []

        def work():
            with sampled() as counts:
                found.append(counts)

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        assert found == [{}]


def test_a_turn_leaves_the_run_where_its_ticks_do():
    """Ticks that are made again before a turn count neither as time nor as way."""
    scene = Scene.load("gao2016", SMALL | {"solver.dynamics": "quasi_static"})
    commands = protocol_commands(scene.protocol, 0.01)[:90]
    alone, run = Simulator(scene), _Run("tick", Simulator(scene), 0.0)
    for command in commands:
        alone.step(command, 0.01)
    for start, end in ((0, 2), (2, 60), (60, 60), (60, 90)):
        run.turn(commands[start:end], 0.01)
    assert len(run.times) == len(run.inserted) == 90
    seen, there = run.simulator.observe(), alone.observe()
    assert (seen.time, seen.insertion_depth) == (there.time, there.insertion_depth)
    assert (seen.base_force == there.base_force).all()
