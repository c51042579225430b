# SPDX-License-Identifier: Apache-2.0
"""Numerical stability under stress: a sweep of small scenes, and a long run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from needle_sim_ros.benchmark.long_run import long_run
from needle_sim_ros.benchmark.result import BenchmarkResult, Row
from needle_sim_ros.benchmark.stability_cells import cells
from needle_sim_ros.benchmark.stability_cells_3d import cells_3d
from needle_sim_ros.benchmark.stability_run import CellResult, run_cell
from needle_sim_ros.scene import Scene

Progress = Callable[[int, int], None]

CELLS, QUICK_CELLS = 504, 36
TICKS, QUICK_TICKS = 1_000_000, 6_000
# of the progress bar, a cell counts as so many ticks of the long run
_TICKS_A_CELL = 1000


def stability(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> BenchmarkResult:
    """Sweep small scenes over stiffness, time step, speed, mesh and motion; then run long.

    Every cell must stay finite and bounded and be in equilibrium in every tick looked at,
    by an evaluation that shares nothing with the contact solve; its friction must not hang
    on the presliding stiffness or the time step, nor alternate from tick to tick, nor what is
    left after a hold hang on the time step or the solver's tolerance. Or it is refused, with
    the reason in its row.

    Bounded means: displacements below the tissue's size; axial force below friction limit
    times inserted length plus the tip's limit; lateral force below twenty times what the
    tissue (E times thickness) or the beam (3 EI / l^3) takes to be displaced as far as the
    track is from the undeflected needle.

    Parameters
    ----------
    scene : Scene
        Only named in the result: the cells and the long run have scenes of their own,
        small enough for hundreds of them.
    quick : bool
        The first cells of the design, and a shorter run.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    BenchmarkResult
        ``failed`` cells break one of the conditions above; ``worst_...`` are over the cells
        that are not refused by their scene, the failed ones included.
    """
    count, ticks = (QUICK_CELLS, QUICK_TICKS) if quick else (CELLS, TICKS)
    chosen = cells(count) + cells_3d(quick, count)
    count = len(chosen)
    total = count * _TICKS_A_CELL + ticks
    results = []
    for number, cell in enumerate(chosen):
        results.append(run_cell(cell))
        if progress is not None:
            progress((number + 1) * _TICKS_A_CELL, total)

    def advance(done: int) -> None:
        if progress is not None:
            progress(count * _TICKS_A_CELL + done, total)

    long = long_run(ticks, progress=advance)
    figures: dict[str, float | None] = {
        "cells": len(results),
        "cells_3d": sum(result.cell.dimension == 3 for result in results),
        "held": sum(result.verdict == "held" for result in results),
        "refused": sum(result.verdict == "refused" for result in results),
        "failed": sum(result.verdict == "failed" for result in results),
        "worst_residual": max(result.residual for result in results),
        "worst_friction_change": _worst(
            change
            for result in results
            for change in (result.presliding_change, result.step_change)
        ),
        "worst_presliding_change": _worst(result.presliding_change for result in results),
        "worst_step_change": _worst(result.step_change for result in results),
        "worst_hold_change": _worst(result.hold_step_change for result in results),
        "worst_tolerance_change": _worst(result.tolerance_change for result in results),
        "worst_ringing": _worst(result.ringing for result in results),
        "cell_ticks": sum(result.ticks for result in results),
        **{f"long_run_{name}": value for name, value in long.items()},
    }
    table = _summary(results) + _reasons(results) + [_row(result) for result in results]
    return BenchmarkResult("stability", scene.name, figures, table)


def _worst(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _summary(results: list[CellResult]) -> list[Row]:
    rows: list[Row] = []
    for key in dict.fromkeys((result.cell.motion, result.cell.dynamics) for result in results):
        same = [r for r in results if (r.cell.motion, r.cell.dynamics) == key]
        verdicts = Counter(result.verdict for result in same)
        rows.append(
            {
                "section": "by motion and dynamics",
                "motion": key[0],
                "dynamics": key[1],
                "held": verdicts["held"],
                "refused": verdicts["refused"],
                "failed": verdicts["failed"],
                "residual": max(result.residual for result in same),
                "presliding_change": _worst(result.presliding_change for result in same),
                "step_change": _worst(result.step_change for result in same),
            }
        )
    return sorted(rows, key=lambda row: (row["motion"], row["dynamics"]))


def _reasons(results: list[CellResult]) -> list[Row]:
    return [
        {
            "section": f"{verdict}",
            "cell": result.cell.number,
            "motion": result.cell.motion,
            "reason": result.reason,
        }
        for verdict in ("failed", "refused")
        for result in results
        if result.verdict == verdict
    ]


def _row(result: CellResult) -> Row:
    cell = result.cell
    levels = {name: value for name, value in cell.level.items() if name != "dynamics"}
    return {
        "section": f"cells in {cell.dimension}D; friction, cutting, presliding per E x thickness",
        "cell": cell.number,
        "motion": cell.motion,
        "dynamics": cell.dynamics,
        **levels,
        "verdict": result.verdict,
        "ticks": result.ticks,
        "residual": result.residual,
        "of": result.condition or "-",
        "presliding_change": result.presliding_change,
        "step_change": result.step_change,
        "hold_change": result.hold_step_change,
        "tolerance_change": result.tolerance_change,
        "ringing": result.ringing,
    }
