# SPDX-License-Identifier: Apache-2.0
"""What the judge of the stability benchmark sees in a run, and cells that rang once."""

import pytest

from needle_sim_ros.benchmark.stability_cells import cells
from needle_sim_ros.benchmark.stability_run import Trace, run_cell, run_moves
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator


def test_ringing_is_the_least_of_four_alternations_in_a_row():
    up_and_down = [1.0, 2.0, 1.2, 1.9, 1.3, 1.8]  # changes of 1, 0.8, 0.7, 0.6, 0.5
    assert Trace(friction=up_and_down, ends=[5]).ringing == pytest.approx(0.5 / 2)
    assert Trace(friction=up_and_down[:5], ends=[4]).ringing == 0.0


def test_what_the_base_makes_alternate_is_no_ringing():
    strokes = [1.0, -1.0, 1.0, -1.0, 1.0, -1.0]
    assert Trace(friction=strokes, ends=[0, 1, 2, 3, 4, 5]).ringing == 0.0
    assert Trace(friction=[1.0, 2.0, 3.0, 2.0, 1.0, 0.0], ends=[5]).ringing == 0.0
    assert Trace(friction=[0.0] * 9, ends=[8]).ringing == 0.0


@pytest.mark.parametrize("number", [312, 392, 497])
def test_friction_does_not_alternate_where_points_are_caught(number):
    """By 9, 14 and 21 % of its largest, tick for tick, as long as only jumps of the base's
    velocity were settled: full and reduced dynamics."""
    cell = cells(number + 1)[number]
    ran = run_moves(Simulator(Scene.from_dict(cell.scene)), cell.moves, cell.level["time_step"])
    assert max(map(abs, ran.friction)) > 0
    assert ran.ringing < 1e-3


@pytest.mark.parametrize("number", [3, 91, 183, 312, 458])
def test_what_lasts_an_instant_leaves_no_mark(number):
    """In the shock of a stop friction turns round and the tip is unloaded; what is left of it in
    the hold hung on the time step by 1.3 to 3.3 % where static friction came back at once, or
    the tip bore less from then on."""
    result = run_cell(cells(number + 1)[number])
    assert result.verdict == "held", result.reason
    assert result.step_change < 5e-3


@pytest.mark.parametrize("number", [127, 258, 326, 337, 385, 435])
def test_what_happens_within_a_step_does_not_hang_on_it(number):
    """A surface that breaks, a tip that lags, a track that turns: what is left hung on the time
    step by 1.0 to 3.6 % as long as these came at the step's end, or nearly, or in the midst."""
    result = run_cell(cells(number + 1)[number])
    assert result.verdict == "held", result.reason
    assert max(result.step_change, result.hold_step_change or 0.0) < 8e-3


def test_the_tip_bears_what_it_cuts_in_every_step():
    """Where a segment of the track turned in the midst of a step it bore nothing for that step."""
    cell = cells(436)[435]
    dt = cell.level["time_step"] / 4
    sim = Simulator(Scene.from_dict(cell.scene).with_changes({"solver.time_step": dt}))
    bears = []
    for _ in range(4 * cell.moves[0].ticks):
        seen = sim.step(cell.moves[0].command(), dt)
        if sim.snapshot().contact.inserted:
            bears.append(seen.tip_force)
    assert len(bears) > 300
    assert min(bears[20:]) > 0.2 * max(bears)
