# SPDX-License-Identifier: Apache-2.0
"""How fast a tick is: the simulator against the paper's algorithm as printed, in one run.

All runs advance side by side along the scene's protocol, a few ticks each in turn, so that
what else the machine does hits them alike and only ratios are reported as figures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.benchmark.paper import PAPER_NODES, PaperSimulator
from needle_sim_ros.benchmark.parts import costs
from needle_sim_ros.benchmark.profile import sampled
from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.benchmark.trajectory import hurried
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator, Snapshot

Progress = Callable[[int, int], None]
# Scene, recording or not, subscribers or not, to a row with ticks, overruns and tick times.
NodeMeasurement = Callable[[Scene, bool, bool], Row]

# Modes of the reduced run where the scene names none.
REDUCED_MODES = 60
_QUICK = 8.0
# The scene on which the paper's algorithm runs beside a 3D one.
PLANAR = "gao2016"
_PLANAR_HASTE = 32.0
# Ticks in turn of the runs that are hurried. A tick with large matrices leaves the next run's
# first ticks a cold cache, which they would not have by themselves: the last ticks of a run's
# turn are made again, untimed, before its next one.
_BLOCK = 8
_WARM = 4
_SHOWN_PARTS = 12


@dataclass
class _Run:
    """One of the simulations that run side by side."""

    name: str
    simulator: Simulator | PaperSimulator
    setup: float
    times: list[float] = field(default_factory=list)
    inserted: list[bool] = field(default_factory=list)
    again: tuple[Snapshot, Sequence[BaseCommand]] | None = None

    def turn(self, commands: Sequence[BaseCommand], dt: float) -> None:
        """Time some ticks, with the caches as the ticks before leave them."""
        simulator = self.simulator
        if isinstance(simulator, PaperSimulator):  # it fills the caches anew in every iteration
            for command in commands:
                self.tick(command, dt)
            return
        if self.again is not None:
            before, latest = self.again
            simulator.restore(before)
            for command in latest:
                self._step(command, dt)
        first = max(0, len(commands) - _WARM)
        for command in commands[:first]:
            self.tick(command, dt)
        self.again = simulator.snapshot(), commands[first:]
        for command in commands[first:]:
            self.tick(command, dt)

    def tick(self, command: BaseCommand, dt: float) -> None:
        """Time one tick and the reading of what a node publishes."""
        began = time.perf_counter()
        process = self._step(command, dt)
        self.times.append(time.perf_counter() - began)
        self.inserted.append(process not in (Process.FREE, Process.CONTACT))

    def _step(self, command: BaseCommand, dt: float) -> Process:
        seen = self.simulator.step(command, dt)
        _ = seen.tip_deflection, seen.base_force, seen.marker_displacements
        return seen.process

    @property
    def milliseconds(self) -> NDArray[np.float64]:
        return 1e3 * np.array(self.times)

    def median(self) -> float:
        return float(np.median(self.milliseconds))

    def p99(self) -> float:
        return float(np.percentile(self.milliseconds, 99))


def speed(
    scene: Scene,
    quick: bool = False,
    progress: Progress | None = None,
    node: NodeMeasurement | None = None,
) -> BenchmarkResult:
    """Time the ticks of a scene over its protocol.

    Parameters
    ----------
    scene : Scene
        The bare tick is that of the scene as it is. In 2D its quasi-static, Newmark and reduced
        variants run beside it and, without regions, the paper's algorithm; in 3D the paper's
        algorithm on its own scene, which it goes through much faster.
    quick : bool
        The paper's algorithm, full Newmark and the node's loop run the protocol eight
        times as fast: as deep, in an eighth of the ticks. An iteration of the first two
        costs the same at any speed.
    progress : callable, optional
        Called with (done, total) ticks.
    node : callable, optional
        Measures the node's loop in real time, ``ros.loop_measurement.measure_loop``; without
        it the node's figure is None.

    Returns
    -------
    BenchmarkResult
        Figures as the design names them; track growth is included in all of them.
    """
    runs = _runs(scene)
    dt = scene.solver.time_step
    commands = protocol_commands(scene.protocol, dt)
    fewer = protocol_commands(hurried(scene, _QUICK).protocol, dt) if quick else commands
    slow = [runs[role] for role in ("newmark", "paper") if role in runs]
    side_by_side = [
        (run, fewer if any(run is other for other in slow) else commands) for run in _distinct(runs)
    ]
    if scene.dimension == 3:
        side_by_side = [
            (run, _planar_commands(dt) if run is runs["paper"] else own)
            for run, own in side_by_side
        ]
    blocks = max(1, len(fewer) // _BLOCK)
    for number in range(blocks):
        first = number % len(side_by_side)
        for run, own in side_by_side[first:] + side_by_side[:first]:
            share = len(own) / blocks
            run.turn(own[round(number * share) : round((number + 1) * share)], dt)
        if progress is not None:
            progress(round((number + 1) * len(fewer) / blocks), len(fewer))
    result = BenchmarkResult("speed", scene.name, _figures(scene, runs), _rows(runs))
    result.table += _parts(scene, commands, runs["tick"])
    if scene.dimension == 2:  # in 3D each variant would be a set-up of its own
        parts = costs(scene)
        result.table += parts.table
        result.figures |= parts.figures
    if node is not None:
        _measure_node(hurried(scene, _QUICK) if quick else scene, node, result, runs)
    return result


def _planar_commands(dt: float) -> list[BaseCommand]:
    return protocol_commands(hurried(Scene.load(PLANAR), _PLANAR_HASTE).protocol, dt)


def _runs(scene: Scene) -> dict[str, _Run]:
    """Return the runs by role; roles that come to the same simulation share it."""
    modes = scene.solver.modes or REDUCED_MODES
    roles = {
        "tick": (scene.solver.dynamics, scene.solver.modes),
        "quasi_static": ("quasi_static", 0),
        "newmark": ("newmark", 0),
        "reduced": ("newmark", modes),
    }
    if roles["tick"][0] == "quasi_static":
        roles["tick"] = roles["quasi_static"]
    if scene.dimension == 3:  # set-ups in 3D are dear: what nobody chose is left out
        roles = {"tick": roles["tick"]}
    runs: dict[str, _Run] = {}
    made: dict[tuple[str, int], _Run] = {}
    for role, settings in roles.items():
        if settings not in made:
            dynamics, count = settings
            changes = {"solver.dynamics": dynamics, "solver.modes": count}
            began = time.perf_counter()
            simulator = Simulator(scene.with_changes(changes))
            name = f"{dynamics}, {count} modes" if count else dynamics
            made[settings] = _Run(name, simulator, time.perf_counter() - began)
        runs[role] = made[settings]
    if scene.dimension == 3 or not scene.tissue.regions:
        began = time.perf_counter()
        paper = PaperSimulator(Scene.load(PLANAR) if scene.dimension == 3 else scene)
        name = f"paper as printed, about {PAPER_NODES} nodes"
        if scene.dimension == 3:
            name += f", {PLANAR} in 2D"
        runs["paper"] = _Run(name, paper, time.perf_counter() - began)
    return runs


def _distinct(runs: dict[str, _Run]) -> list[_Run]:
    return list({id(run): run for run in runs.values()}.values())


def _figures(scene: Scene, runs: dict[str, _Run]) -> dict[str, float | None]:
    tick, paper = runs["tick"], runs.get("paper")
    steady = runs.get("quasi_static")

    def over_steady(role: str) -> float | None:
        return runs[role].median() / steady.median() if steady and role in runs else None

    figures: dict[str, float | None] = {
        "paper_over_tick_median": None if paper is None else paper.median() / tick.median(),
        "tick_p99_over_median": tick.p99() / tick.median(),
        "newmark_over_quasi_static": over_steady("newmark"),
        "reduced_over_quasi_static": over_steady("reduced"),
        "node_overrun_fraction": None,
    }
    if scene.dimension == 3:
        simulator = tick.simulator
        assert isinstance(simulator, Simulator)
        figures |= {
            "tick_3d_median_ms": tick.median(),
            "tick_3d_p99_ms": tick.p99(),
            "tick_3d_nodes": float(simulator.nodes),
            "tick_3d_waits": float(simulator.statistics.waits),
        }
    return figures


def _rows(runs: dict[str, _Run]) -> list[Row]:
    paper = runs.get("paper")
    rows: list[Row] = []
    for run in _distinct(runs):
        inside = run.milliseconds[np.array(run.inserted)]
        rows.append(
            {
                "section": "tick, track growth and reading the outputs included",
                "run": run.name + (" (the scene's own)" if run is runs["tick"] else ""),
                "ticks": len(run.times),
                "median_ms": run.median(),
                "p99_ms": run.p99(),
                "max_ms": float(run.milliseconds.max()),
                "median_inserted_ms": float(np.median(inside)) if len(inside) else None,
                "paper_over_it": None if paper is None else paper.median() / run.median(),
                "setup_s": run.setup,
            }
        )
    return rows


def _measure_node(
    scene: Scene, node: NodeMeasurement, result: BenchmarkResult, runs: dict[str, _Run]
) -> None:
    """Add the node's loop: alone, recording, and recording with subscribers."""
    paper = runs.get("paper")
    cases = {"alone": (False, False), "recording": (True, False), "and subscribers": (True, True)}
    for name, (record, subscribe) in cases.items():
        row = node(scene, record, subscribe)
        result.table.append(
            {
                "section": f"the node's loop at {1 / scene.solver.time_step:g} Hz, in real time",
                "node": name,
                **row,
                "paper_over_it": None if paper is None else paper.median() / row["median_ms"],
            }
        )
        if name == "recording":
            deadlines = row["ticks"] + row["overruns"]
            result.figures["node_overrun_fraction"] = row["overruns"] / max(1, deadlines)


def _parts(scene: Scene, commands: list[BaseCommand], used: _Run) -> list[Row]:
    """Return where the tick of the scene spends its time, by function."""
    assert isinstance(used.simulator, Simulator)
    used.simulator.reset()
    run = _Run("profile", used.simulator, 0.0)
    with sampled() as counts:
        for command in commands:
            run.tick(command, scene.solver.time_step)
    total = sum(counts.values())
    shown = counts.most_common(_SHOWN_PARTS)
    shares = [(name, count / total) for name, count in shown]
    if total > sum(count for _, count in shown):
        shares.append(("the rest", 1 - sum(share for _, share in shares)))
    section = f"where the scene's own tick spends its time, {total} samples"
    return [{"section": section, "function": name, "share": share} for name, share in shares]
