# SPDX-License-Identifier: Apache-2.0
"""How many "what if" a planner gets: rollouts and branches per second, in times real time.

Rollouts of several depths and ticks of the scene's own simulator take turns in one run.
Times are processor time, of one core whatever else the machine does; the scaling over
processes is by the clock on the wall too.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import ExitStack

import numpy as np

from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.parallel import available_cores, executor
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.quick import QuickSimulator, planning_scene
from needle_sim_ros.planning.rollout import roll_out
from needle_sim_ros.planning.work import Trial, run_trials
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Progress = Callable[[int, int], None]

_PARTS = (1 / 3, 2 / 3, 1.0)  # of the planned depth
_ROUNDS, _QUICK_ROUNDS = 20, 5
_IN_A_ROW = 3  # as a planner makes them: the first finds what the ticks left in the caches
_TICKS = 50  # of the scene's own simulator, each round
_BRANCHES = 40
_TRIALS, _TOGETHER = 24, 2  # rollouts of a turn, and of a task
_TURNS = 5
_MOST_CALLS = 200


def rollouts(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> BenchmarkResult:
    """Time rollouts of a scene's insertion.

    Parameters
    ----------
    scene : Scene
    quick : bool
        Fewer rounds.
    progress : callable, optional
        Called with (done, total) steps.

    Returns
    -------
    BenchmarkResult
        ``times_real_time`` is the simulated time of the whole insertion over the processor
        time of a rollout, medians; ``end_error`` the largest relative error at its end.
    """
    rounds = _QUICK_ROUNDS if quick else _ROUNDS
    total = rounds + 3

    def step(done: int) -> None:
        if progress is not None:
            progress(done, total)

    began = time.process_time()
    simulator = QuickSimulator(_asked(scene))
    setup = time.process_time() - began
    whole = Insertion.of(scene)
    node = Simulator(scene)
    step(1)
    times: dict[float, list[float]] = {part: [] for part in _PARTS}
    ticks: list[float] = []
    steps: dict[float, int] = {}
    for number in range(rounds):
        for part in _PARTS:
            insertion = whole.with_travel(part * whole.travel)
            for _ in range(_IN_A_ROW):
                began = time.process_time()
                steps[part] = roll_out(simulator, insertion).steps
                times[part].append(time.process_time() - began)
        ticks += _node_ticks(node, whole, rounds, number)
        step(number + 2)
    result = BenchmarkResult("rollouts", scene.name)
    for part in _PARTS:
        wall, simulated = float(np.median(times[part])), part * whole.travel / whole.speed
        result.table.append(
            {
                "section": f"one rollout, one core; set-up {setup:.2f} s once",
                "depth_mm": 1e3 * part * whole.travel,
                "steps": steps[part],
                "median_ms": 1e3 * wall,
                "rollouts_per_s": 1 / wall,
                "times_real_time": simulated / wall,
                "ticks_of_the_scene": wall / float(np.median(ticks)),
            }
        )
    full = result.table[-1]
    result.figures = {
        "times_real_time": full["times_real_time"],
        "rollouts_per_s": full["rollouts_per_s"],
        "rollout_over_tick": full["ticks_of_the_scene"],
        "end_error": _end_error(scene, simulator, whole),
        "branches_per_s": _branches(simulator, whole),
    }
    step(total - 1)
    result.table += _scaling(simulator, whole, result)
    step(total)
    return result


def _node_ticks(node: Simulator, whole: Insertion, rounds: int, number: int) -> list[float]:
    """Time ticks of the scene's own simulator, as deep as this round of all rounds."""
    dt = node.scene.solver.time_step
    seconds = []
    start = whole.travel * number / rounds
    if number == 0:
        node.reset()
        node.step(whole.command(0.0), dt)
    for k in range(_TICKS):
        travel = start + (k + 1) * whole.travel / rounds / _TICKS
        began = time.process_time()
        node.step(whole.command(travel), dt)
        seconds.append(time.process_time() - began)
    return seconds


def _asked(scene: Scene) -> Scene:
    """Return the scene of the rollouts; in 3D without markers, as a planner makes them."""
    planning = planning_scene(scene)
    return planning if scene.dimension == 2 else planning.with_changes({"markers": []})


def _end_error(scene: Scene, simulator: QuickSimulator, whole: Insertion) -> float:
    """Return the largest relative error at the end: tip deflection, force, markers.

    In 2D against the same model on a mesh and a track of half the scene's spacings, in 3D on
    the scene's own.
    """
    from needle_sim_ros.tissue.mesh import spacings

    across, along, _ = spacings(scene)
    part = 0.5 if scene.dimension == 2 else 1.0
    finer = scene.with_changes(
        {
            "solver.dynamics": "quasi_static",
            "solver.modes": 0,
            "solver.track_spacing": part * scene.solver.track_spacing,
            "tissue.mesh.spacing_across": part * across,
            "tissue.mesh.spacing_along": part * along,
            "markers": simulator.scene.markers,
        }
    )
    ends = []
    for each in (simulator, QuickSimulator(finer)):
        roll_out(each, whole)
        seen = each.observe()
        ends.append((seen.tip_deflection, seen.base_force, seen.marker_displacements))
    return max(
        float(np.abs(a - b).max() / max(np.abs(b).max(), 1e-300))
        for a, b in zip(*ends, strict=True)
        if np.size(b)
    )


def _branches(simulator: QuickSimulator, whole: Insertion) -> float:
    """Return how often a second the state at full depth can be taken up and gone on from."""
    roll_out(simulator, whole.with_travel(0.98 * whole.travel))
    start, seconds = simulator.snapshot(), []
    ahead = 0.01 * whole.travel
    for k in range(_BRANCHES):
        aside = 1e-4 * (k % 5 - 2)
        place = whole.place(0.98 * whole.travel + ahead) + np.array([aside, 0.0, 0.0])
        began = time.process_time()
        simulator.restore(start)
        seen = simulator.step(BaseCommand(position=place), ahead / whole.speed)
        _ = seen.tip_position
        seconds.append(time.process_time() - began)
    return 1 / float(np.median(seconds))


def _timed(scene: Scene, trials: list[Trial]) -> tuple[int, int, float]:
    """Roll trials out in a worker; return its process, how many, and its processor time, s."""
    began = time.process_time()
    done = len(run_trials(scene, trials))
    return os.getpid(), done, time.process_time() - began


def _warm_up(scene: Scene, trials: list[Trial], pool: Executor, count: int) -> None:
    """Have every worker prepare the tissue; an idle one may take several tasks meanwhile."""
    ready: set[int] = set()
    for _ in range(_MOST_CALLS):
        calls = [pool.submit(_timed, scene, trials) for _ in range(count)]
        ready |= {call.result()[0] for call in calls}
        if len(ready) == count:
            return


def _scaling(simulator: QuickSimulator, whole: Insertion, result: BenchmarkResult) -> list[Row]:
    """Time the same trials on growing numbers of prepared processes, in turns.

    What the workers' clocks say of a loaded machine is how loaded it is. What a rollout takes
    of a processor with so many of them at work is what they cost each other.
    """
    scene, trials = simulator.scene, [Trial(whole)] * _TRIALS
    workers = [1]
    while 2 * workers[-1] <= available_cores():
        workers.append(2 * workers[-1])
    walls: dict[int, list[float]] = {count: [] for count in workers}
    spent: dict[int, list[float]] = {count: [] for count in workers}
    with ExitStack() as stack:
        pools = {count: stack.enter_context(executor(count)) for count in workers}
        for count, pool in pools.items():
            _warm_up(scene, trials[:1], pool, count)
        for _ in range(_TURNS):
            for count, pool in pools.items():
                began = time.perf_counter()
                calls = [
                    pool.submit(_timed, scene, trials[k : k + _TOGETHER])
                    for k in range(0, _TRIALS, _TOGETHER)
                ]
                answers = [call.result() for call in calls]
                walls[count].append((time.perf_counter() - began) / _TRIALS)
                spent[count].append(sum(seconds for *_, seconds in answers) / _TRIALS)
    rows: list[Row] = []
    for count in workers:
        alone, together = np.array(spent[1]), np.array(spent[count])
        rows.append(
            {
                "section": "rollouts to full depth side by side, one process a worker; in turns",
                "workers": count,
                "rollouts_per_s": 1 / float(np.median(walls[count])),
                "speed_up": float(np.median(np.array(walls[1]) / walls[count])),
                "processor_ms": 1e3 * float(np.median(together)),
                "speed_up_by_processor": count * float(np.median(alone / together)),
            }
        )
    result.figures["speed_up_all_cores"] = rows[-1]["speed_up"]
    result.figures["speed_up_by_processor"] = rows[-1]["speed_up_by_processor"]
    return rows
