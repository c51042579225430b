# SPDX-License-Identifier: Apache-2.0
"""Running a cell of the stability benchmark, and what its answer is judged by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from needle_sim_ros.benchmark.equilibrium import residuals
from needle_sim_ros.benchmark.stability_cells import Cell
from needle_sim_ros.benchmark.stability_motions import Move
from needle_sim_ros.errors import CommandError, SceneError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.observation import Observation
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

# Largest residual of an equilibrium, relative; largest change of an answer, as a fraction.
RESIDUAL = 1e-8
CHANGE = 0.01
# Lateral force per deviation of the track from the undeflected needle that tissue (E x
# thickness) or beam (3 EI / l^3) can carry, with room for the form of either.
_CARRIED = 20.0
# N, below which a force is rounding
_NOTHING = 1e-12
# checks of equilibrium in a move, beside those at its end
_CHECKS = 3
# changes of direction in a row that are no motion any more
_FLIPS = 4


@dataclass
class Trace:
    """What a run shows: one row per tick of the cell's own time step.

    Attributes
    ----------
    friction, tip : list of float
        N.
    answers : list of ndarray
        Base force (3), tip deflection (3) and displacements of the markers, tick by tick.
    residual : float
        Worst relative residual, and of which condition.
    refusal : str
        Why a command was refused; the run ends there.
    fault : str
        What is wrong: not finite, or not bounded.
    """

    friction: list[float] = field(default_factory=list)
    tip: list[float] = field(default_factory=list)
    answers: list[tuple[Vector, Vector, Vector]] = field(default_factory=list)
    residual: float = 0.0
    condition: str = ""
    refusal: str = ""
    fault: str = ""
    ends: list[int] = field(default_factory=list)
    ticks: int = 0

    @property
    def ringing(self) -> float:
        """By how much friction alternates from tick to tick in a move, as a fraction.

        The least of a few alternations in a row, relative to the largest friction.
        """
        largest = max((abs(force) for force in self.friction), default=0.0)
        worst, start = 0.0, 0
        for end in self.ends:
            change = np.diff(self.friction[start : end + 1])
            start = end + 1
            one, next_one = change[:-1], change[1:]
            size = np.where(one * next_one < 0, np.minimum(np.abs(one), np.abs(next_one)), 0.0)
            if len(size) >= _FLIPS:
                rows = np.lib.stride_tricks.sliding_window_view(size, _FLIPS)
                worst = max(worst, float(rows.min(axis=1).max()))
        return worst / largest if largest else 0.0


@dataclass
class CellResult:
    """What a cell shows; changes are None where they were not measured."""

    cell: Cell
    verdict: str = "held"
    reason: str = ""
    residual: float = 0.0
    condition: str = ""
    presliding_change: float | None = None
    step_change: float | None = None
    hold_step_change: float | None = None
    tolerance_change: float | None = None
    ringing: float | None = None
    ticks: int = 0

    def fail(self, reason: str) -> None:
        """Add a reason for which the cell fails."""
        self.reason = f"{self.reason}; {reason}" if self.verdict == "failed" else reason
        self.verdict = "failed"


def run_moves(
    simulator: Simulator, moves: tuple[Move, ...], dt: float, finer: int = 1, check: bool = False
) -> Trace:
    """Carry out moves and keep what is seen.

    Parameters
    ----------
    simulator : Simulator
    moves : tuple of Move
    dt : float
        Time step for which the moves are counted, s.
    finer : int
        Ticks that each of them is divided into.
    check : bool
        Work out the residuals of some of the ticks too, which costs solves.
    """
    trace = Trace()
    for move in moves:
        command = move.command()
        every = max(1, move.ticks // _CHECKS)
        for tick in range(1, move.ticks + 1):
            for _ in range(finer):
                before = simulator.snapshot()
                try:
                    seen = simulator.step(command, dt / finer)
                except CommandError as error:
                    trace.refusal = f"CommandError: {error}"
                    if simulator.snapshot() is not before:
                        trace.fault = "a refused command changed the state"
                    return trace
                trace.ticks += 1
            trace.friction.append(seen.friction_force)
            trace.tip.append(seen.tip_force)
            answer = (seen.base_force, seen.tip_deflection, seen.marker_displacements)
            trace.answers.append(answer)
            trace.fault = _fault(simulator, seen)
            if trace.fault:
                return trace
            if check and (tick % every == 0 or tick == move.ticks):
                worst, name = residuals(simulator, before).worst()
                if worst > trace.residual or math.isnan(worst):
                    trace.residual, trace.condition = worst, name
        trace.ends.append(len(trace.friction) - 1)
    return trace


def _fault(simulator: Simulator, seen: Observation) -> str:
    """Return what makes a tick not finite or not bounded, or nothing."""
    scene, contact = simulator.scene, simulator.snapshot().contact
    shown = np.concatenate(
        [
            seen.base_force,
            seen.base_torque,
            seen.tip_position,
            seen.marker_displacements.ravel(),
            contact.forces.ravel(),
            contact.moved.ravel(),
            [seen.friction_force, seen.tip_force, seen.insertion_depth],
        ]
    )
    if not np.isfinite(shown).all():
        return "not finite"
    size = max(scene.tissue.size)
    moved = max(
        float(np.abs(contact.moved).max(initial=0.0)),
        float(np.abs(seen.marker_displacements).max(initial=0.0)),
    )
    if moved > size:
        return f"displacement of {moved:.3g} m, more than the tissue's size"
    law = scene.interaction
    assert law.puncture.force is not None and contact is not None
    ripple = 1.0 + law.cutting.ripple.amplitude
    inserted = contact.depth + scene.solver.track_spacing if contact.inserted else 0.0
    bound = law.friction.static * inserted + max(law.puncture.force, law.cutting.force) * ripple
    axial = abs(float(seen.base_force[2]))
    if axial > bound * (1 + 1e-9):
        return f"axial force of {axial:.4g} N, above its bounds of {bound:.4g} N"
    return _lateral_fault(simulator)


def _lateral_fault(simulator: Simulator) -> str:
    scene, state = simulator.scene, simulator.snapshot()
    contact = state.contact
    if contact.track is None or len(contact.arclength) == 0:
        return ""
    total = float(np.abs(contact.lateral.sum(axis=1)).max())
    held = contact.track.points[: len(contact.arclength)]
    aside = np.abs(state.pose.aside(held)).max()
    off = float(aside + np.abs(contact.moved).max())
    deep = scene.tissue.thickness if scene.dimension == 2 else scene.tissue.size[-1]
    tissue = scene.tissue.youngs_modulus * deep * off
    beam = 3 * scene.needle.flexural_rigidity * off / float(contact.arclength[0]) ** 3
    carried = _CARRIED * max(tissue, beam)
    if total > max(carried, _NOTHING):
        return f"lateral force of {total:.3g} N, {total / carried * _CARRIED:.3g} times the carried"
    return ""


def run_cell(cell: Cell) -> CellResult:
    """Run a cell and its variations and judge it.

    Nothing that goes wrong in a cell goes further: it is the cell's result.
    """
    result = CellResult(cell)
    try:
        _judge(cell, result)
    except SceneError as error:
        result.verdict, result.reason = "refused", f"SceneError: {error}"
    except Exception as error:  # whatever it is, it is what this cell shows
        result.fail(f"{type(error).__name__}: {error}")
    return result


def _judge(cell: Cell, result: CellResult) -> None:
    dt = float(cell.level["time_step"])
    scene = Scene.from_dict(cell.scene)
    simulator = Simulator(scene)
    first = run_moves(simulator, cell.moves, dt, check=True)
    result.ticks, result.residual, result.condition = first.ticks, first.residual, first.condition
    result.ringing = first.ringing
    if first.fault:
        result.fail(first.fault)
    if not first.residual <= RESIDUAL:
        result.fail(f"residual {first.residual:.2g} of {first.condition}")
    kappa = scene.interaction.friction.presliding_stiffness
    stiffer = _again(simulator, cell, dt, {"friction.presliding_stiffness": 2 * kappa})
    result.presliding_change = _change(first, stiffer, cell.dynamics)
    simulator.change_interaction({"friction.presliding_stiffness": kappa})
    if cell.dynamics != "quasi_static":
        simulator = _varied(scene, {"solver.time_step": dt / 4})
    simulator.reset()
    finer = run_moves(simulator, cell.moves, dt, finer=4)
    result.step_change = _change(first, finer, cell.dynamics)
    if cell.ends_in_hold and not first.refusal:
        _judge_hold(cell, scene, result)
    for name in (
        "presliding_change",
        "step_change",
        "hold_step_change",
        "tolerance_change",
        "ringing",
    ):
        value = getattr(result, name)
        if value is not None and not value <= CHANGE:
            result.fail(f"{name.replace('_', ' ')} {value:.2g}")
    for other in (stiffer, finer):
        if other.fault:
            result.fail(f"varied: {other.fault}")
    if first.refusal and result.verdict != "failed":
        result.verdict, result.reason = "refused", first.refusal


def _again(simulator: Simulator, cell: Cell, dt: float, laws: Mapping[str, object]) -> Trace:
    simulator.reset()
    simulator.change_interaction(laws)
    return run_moves(simulator, cell.moves, dt)


def _varied(scene: Scene, changes: Mapping[str, object]) -> Simulator:
    return Simulator(scene.with_changes(changes))


def _judge_hold(cell: Cell, scene: Scene, result: CellResult) -> None:
    """Insert in 0.6 s, hold for 0.4: with 20 ms and 1 ms, over two decades of tolerance."""
    x, _, z = scene.protocol[0].velocity
    way = math.hypot(x, z)
    speed = way / 0.6
    ticks = max(1, round(way / (speed * 0.02)))
    pace = way / (ticks * 0.02)
    inward = Move(ticks, (pace * x / way, 0.0, pace * z / way))
    moves = (inward, Move(20))
    last = []
    for step, tolerance in ((0.02, 1e-10), (0.001, 1e-10), (0.02, 1e-8), (0.02, 1e-6)):
        changes = {"solver.time_step": step, "solver.tolerance": tolerance}
        trace = run_moves(_varied(scene, changes), moves, 0.02, finer=round(0.02 / step))
        if trace.refusal or trace.fault:
            result.fail(f"hold: {trace.refusal or trace.fault}")
            return
        last.append(trace)
    result.hold_step_change = _answer_change(last[0], last[1])
    result.tolerance_change = max(_answer_change(last[0], other) for other in last[2:])


def _change(one: Trace, other: Trace, dynamics: str) -> float:
    """Return the largest difference of friction, relative to its largest value.

    A value counts as far as it is outside what the other run shows a tick earlier, now and a
    tick later: when within a tick the surface breaks, the tip snaps on or the needle starts to
    slide is known to a tick only. With inertia and damping a jump of the base's velocity
    sends a wave that a coarse step cannot show: there the ends of the moves count.
    """
    count = min(len(one.friction), len(other.friction))
    if count == 0:
        return 0.0
    a, b = np.array(one.friction[:count]), np.array(other.friction[:count])
    largest = float(np.abs(a).max())
    padded = np.concatenate([b[:1], b, b[-1:]])
    near = np.stack([padded[:-2], b, padded[2:]])
    off = np.maximum(np.maximum(a - near.max(axis=0), near.min(axis=0) - a), 0.0)
    if dynamics != "quasi_static":
        off = off[[end for end in one.ends if end < count]]
    return 0.0 if largest == 0 else float(off.max(initial=0.0)) / largest


def _answer_change(one: Trace, other: Trace) -> float:
    """Return the largest difference at the end, each quantity relative to its largest."""
    worst = 0.0
    for which in range(len(one.answers[-1])):
        largest = max(float(np.abs(answer[which]).max()) for answer in one.answers)
        largest = max(largest, 1e-9)  # a nanonewton or a nanometre is rounding
        if largest > 0:
            apart = float(np.abs(one.answers[-1][which] - other.answers[-1][which]).max())
            worst = max(worst, apart / largest)
    friction = max(np.abs(one.friction).max(), np.abs(one.tip).max())
    if friction > 0:
        worst = max(worst, abs(one.friction[-1] - other.friction[-1]) / float(friction))
        worst = max(worst, abs(one.tip[-1] - other.tip[-1]) / float(friction))
    return worst
