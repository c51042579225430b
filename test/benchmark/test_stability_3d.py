# SPDX-License-Identifier: Apache-2.0
"""Cells of the stability benchmark in 3D hold; the judge sees what is wrong there too."""

import numpy as np
import pytest

from needle_sim_ros.benchmark.equilibrium import residuals
from needle_sim_ros.benchmark.stability_cells_3d import cells_3d
from needle_sim_ros.benchmark.stability_run import run_cell
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator


def test_cells_are_numbered_and_cover_motions_and_dynamics():
    whole, quick = cells_3d(False, 504), cells_3d(True, 60)
    assert [cell.number for cell in whole] == list(range(504, 504 + len(whole)))
    assert {cell.motion for cell in quick} == {cell.motion for cell in whole}
    assert {cell.dynamics for cell in quick} == {"quasi_static", "newmark", "reduced"}
    assert all(cell.dimension == 3 for cell in whole)


@pytest.mark.parametrize("motion", ["3D spin", "3D lateral", "3D reversals"])
def test_cells_hold(motion):
    cell = next(c for c in cells_3d(False, 0) if c.motion == motion)
    result = run_cell(cell)
    assert result.verdict == "held", result.reason
    assert result.residual < 1e-10


def test_the_judge_sees_a_force_out_of_balance():
    """A lateral force along base y that was a percent larger is no equilibrium."""
    cell = next(c for c in cells_3d(False, 0) if c.motion == "3D lateral")
    sim = Simulator(Scene.from_dict(cell.scene))
    for move in cell.moves[:3]:
        for _ in range(move.ticks):
            sim.step(move.command(), 0.02)
    assert residuals(sim).worst()[0] < 1e-10
    state = sim.snapshot()
    lateral = state.contact.lateral * np.array([[1.0], [1.01]])
    sim.restore(state._replace(contact=state.contact._replace(lateral=lateral)))
    assert residuals(sim).worst()[0] > 1e-5
