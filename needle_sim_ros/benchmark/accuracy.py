# SPDX-License-Identifier: Apache-2.0
"""How accurate a scene is for what it costs, over a whole protocol.

Every run is compared at equal times with a converged reference: quasi-static runs with a
quasi-static one on a finer mesh and track; Newmark runs, reduced ones too, with Newmark on
every unknown. Beside each run the paper's iteration is timed, so that the cost is a ratio
that means something on a busy machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from needle_sim_ros.benchmark.paper import PaperSimulator
from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.benchmark.trajectory import (
    Errors,
    Recorded,
    Trajectory,
    driven_in,
    errors,
    hurried,
)
from needle_sim_ros.benchmark.variants import (
    Changes,
    Variant,
    method_changes,
    own_method,
    references,
    variants,
)
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Progress = Callable[[int, int], None]

PAPER = "paper"
_HALF = "default at half the time step"
_QUICK = 4.0
_HASTE = 16.0  # how much faster the pacer is driven in
_BESIDE = 24  # iterations of the paper's algorithm timed beside each run


class Pacer:
    """The paper's iteration with the needle all the way in, timed beside other work.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self._simulator = PaperSimulator(scene)
        self._step = scene.solver.time_step
        driven_in(self._simulator, hurried(scene, _HASTE))

    def once(self) -> float:
        """Return the time of one iteration, s."""
        began = time.perf_counter()
        self._simulator.step(BaseCommand(), self._step)
        return time.perf_counter() - began


@dataclass
class Measured:
    """A run, what it cost, and the paper's iterations beside it."""

    trajectory: Trajectory
    unknowns: int
    setup: float
    tick: float
    paper: float | None

    @property
    def ratio(self) -> float | None:
        """How many of these ticks the paper's iteration takes."""
        return None if self.paper is None else self.paper / self.tick


@dataclass
class Runs:
    """Runs of a scene with some keys changed, each measured once."""

    scene: Scene
    pacer: Pacer | None
    progress: Progress | None
    total: int
    done: int = 0
    made: dict[str, Measured] = field(default_factory=dict)

    def measure(self, changes: Changes, paper: bool = False) -> Measured:
        """Run the protocol with some keys changed; the same settings run once."""
        key = f"{paper} {sorted(changes.items(), key=str)}"
        if key not in self.made:
            self.made[key] = self._run(self.scene.with_changes(changes), paper)
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, self.total)
        return self.made[key]

    def _run(self, scene: Scene, paper: bool) -> Measured:
        began = time.perf_counter()
        simulator = PaperSimulator(scene) if paper else Simulator(scene)
        setup = time.perf_counter() - began
        run, dt = Recorded(simulator), scene.solver.time_step
        commands = protocol_commands(scene.protocol, dt)
        every, beside = max(5, len(commands) // _BESIDE), []
        for number, command in enumerate(commands):
            run.tick(command, dt)
            if self.pacer is not None and number % every == 0:
                beside.append(self.pacer.once())
        unknowns = _unknowns(simulator)
        return Measured(
            run.trajectory,
            unknowns,
            setup,
            run.median_inserted,
            float(np.median(beside)) if beside else None,
        )


def accuracy(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> BenchmarkResult:
    """Compare settings of a scene with a converged reference over its protocol.

    Parameters
    ----------
    scene : Scene
        In 3D see :func:`~needle_sim_ros.benchmark.accuracy_3d.accuracy_3d`.
    quick : bool
        Fewer settings, a reference that is less fine, and the protocol moved four times as
        fast: as deep, in a quarter of the ticks, with puncture, hold and retraction.
    progress : callable, optional
        Called with (done, total) runs.

    Returns
    -------
    BenchmarkResult
        Errors are fractions of the largest magnitude of each quantity in the reference; a
        figure is the largest over all quantities and the whole protocol. Ticks are evened
        out: see :func:`even_out`.
    """
    if scene.dimension == 3:
        from needle_sim_ros.benchmark.accuracy_3d import accuracy_3d

        return accuracy_3d(scene, quick, progress)
    if quick:
        scene = hurried(scene, _QUICK)
    covered = not scene.tissue.regions
    runs = variants(scene, quick)
    bench = Runs(
        scene, Pacer(scene) if covered else None, progress, len(runs) + (9 if quick else 10)
    )
    result = BenchmarkResult("accuracy", scene.name)
    best, checks = _references(bench, scene, quick)
    section = "runs, errors as fractions of the largest magnitude in the reference"
    if quick:
        section += f"; the protocol {_QUICK:g} times as fast"
    for variant in runs:
        measured = bench.measure(variant.changes)
        found = errors(measured.trajectory, best[variant.method].trajectory)
        row = row_of(section, variant, measured, found)
        result.table.append(row)
        if variant.name == "default":
            result.figures[f"default.{variant.method}.max_error"] = found.worst
    result.figures["paper.max_error"] = None
    if covered:
        for method in ("quasi_static", "newmark"):
            variant = Variant(method, PAPER, method_changes(scene, method))
            measured = bench.measure(variant.changes, paper=True)
            found = errors(measured.trajectory, best[method].trajectory)
            result.table.append(row_of(section, variant, measured, found))
            if method == _full(own_method(scene)):
                result.figures["paper.max_error"] = found.worst
    result.table += checks
    for row in checks:
        if row["run"] == _HALF:
            result.figures[f"time_step.{row['method']}.max_error"] = row["max_error"]
            result.figures[f"time_step.{row['method']}.within_a_tick"] = row["within_a_tick"]
    even_out(result.table)
    return result


def even_out(rows: list[Row]) -> None:
    """Scale ticks to a machine on which the paper's iteration always takes its median.

    What else runs on the machine changes from one run to the next, and would decide which
    setting looks faster. As measured they stay in ``measured_tick_ms``.
    """
    paced = [row for row in rows if row["paper_over_it"] is not None]
    if not paced:
        return
    paper = float(np.median([row["tick_ms"] * row["paper_over_it"] for row in paced]))
    for row in paced:
        row["measured_tick_ms"] = row["tick_ms"]
        row["tick_ms"] = paper / row["paper_over_it"]


def _full(method: str) -> str:
    return "newmark" if method == "reduced" else method


def _unknowns(simulator: Simulator | PaperSimulator) -> int:
    if isinstance(simulator, Simulator):
        return simulator.unknowns
    return int(simulator.tissue.stiffness.shape[0])


def _references(bench: Runs, scene: Scene, quick: bool) -> tuple[dict[str, Measured], list[Row]]:
    """Run the references, and what shows that they are converged."""
    finest, coarser = references(scene, quick)
    best, rows = {}, []
    section = (
        "how converged: the reference against one level coarser, the default against half its "
        "time step"
    )
    half = {"solver.time_step": scene.solver.time_step / 2}
    for method in ("quasi_static", "newmark"):
        own = method_changes(scene, method)
        best[method] = bench.measure({**own, **finest})
        if method == "quasi_static" or not quick:  # the mesh matters alike with inertia
            below = Variant(method, "reference, one level coarser", {**own, **coarser})
            rows.append(_check(section, below, bench.measure(below.changes), best[method]))
    for method in ("quasi_static", "reduced" if quick else "newmark"):
        own = method_changes(scene, method)
        quicker = Variant(method, _HALF, {**own, **half})
        run = bench.measure(quicker.changes)
        rows.append(_check(section, quicker, bench.measure(own), run))
    best["reduced"] = best["newmark"]
    return best, rows


def _check(section: str, variant: Variant, run: Measured, finer: Measured) -> Row:
    """Return the row of a run that is compared with another than the reference."""
    found = errors(run.trajectory, finer.trajectory)
    return row_of(section, variant, run, found) | {"compared": False}


def row_of(section: str, variant: Variant, run: Measured, found: Errors) -> Row:
    """Return the table's row of a run."""
    row: Row = {"section": section, "method": variant.method, "run": variant.name}
    row |= {"unknowns": run.unknowns, "max_error": found.worst}
    row |= found.largest
    row |= {"within_a_tick": max(found.late.values())}
    row |= {f"{name}_rms": value for name, value in found.rms.items()}
    row |= {"setup_s": run.setup, "tick_ms": 1e3 * run.tick, "paper_over_it": run.ratio}
    return row | {"settings": variant.settings, "compared": True}
