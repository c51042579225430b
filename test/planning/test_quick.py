# SPDX-License-Identifier: Apache-2.0
"""Quick rollouts: their error, their variants, states gone back to."""

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Simulator
from needle_sim_ros.errors import NeedleSimError, SceneError
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.quick import QuickSimulator, planning_scene
from needle_sim_ros.planning.rollout import roll_out

PLACE = (0.003, 0.0, -0.03)


@pytest.fixture(scope="module")
def quick(planning_scene_2d):
    return QuickSimulator(planning_scene(planning_scene_2d))


def test_ends_where_steps_twenty_times_as_fine_end(planning_scene_2d, quick):
    """Same mesh and track: what differs is where the heading is taken, within a percent."""
    insertion = Insertion.of(planning_scene_2d)
    coarse = roll_out(quick, insertion)
    fine = Simulator(quick.scene)
    fine.step(insertion.command(0.0), 1.0)
    for travel in np.linspace(0.0, insertion.travel, 20 * coarse.steps)[1:]:
        seen = fine.step(insertion.command(travel), 0.01)
    assert coarse.steps < 30
    deflection = np.linalg.norm(seen.tip_deflection)
    assert np.linalg.norm(coarse.tip - seen.tip_position) < 0.01 * deflection


def test_newmark_is_refused(coarse_scene):
    with pytest.raises(SceneError, match=r"solver\.dynamics"):
        QuickSimulator(coarse_scene({"solver.dynamics": "newmark", "solver.time_step": 0.01}))


def test_a_variant_is_the_scene_prepared_anew(planning_scene_2d, quick):
    """Modulus, friction and bevel change without a factorisation, force included."""
    changes = {
        "tissue.youngs_modulus": 24e3,
        "interaction.friction.kinetic": 11.0,
        "needle.tip.deviation_angle": 0.03,
    }
    insertion = Insertion.of(planning_scene_2d)
    solves = quick._factor.solves
    varied = quick.changed(changes)
    point = quick.material_point(PLACE)
    a = roll_out(varied, insertion, point)
    assert quick._factor.solves - solves < 200  # the point's, and off the prepared path
    anew = QuickSimulator(quick.scene.with_changes(changes))
    b = roll_out(anew, insertion, anew.material_point(PLACE))
    assert a.tip == pytest.approx(b.tip, abs=1e-9)
    assert a.target == pytest.approx(b.target, abs=1e-9)
    assert a.peak_force == pytest.approx(b.peak_force, rel=1e-6)


@pytest.mark.parametrize("key", ["tissue.poisson_ratio", "needle.radius", "solver.track_spacing"])
def test_a_variant_cannot_change_the_mesh(quick, key):
    with pytest.raises(NeedleSimError, match=key):
        quick.changed({key: 1e-3})


def test_material_points_move_as_the_field(planning_scene_2d, quick):
    roll_out(quick, Insertion.of(planning_scene_2d).with_travel(0.02))
    moved = quick.position_of(quick.material_point(PLACE)) - PLACE
    assert moved == pytest.approx(quick.tissue_displacement([PLACE])[0], abs=1e-12)


def test_branches_are_exact(planning_scene_2d, quick):
    roll_out(quick, Insertion.of(planning_scene_2d).with_travel(0.02))
    start, command = quick.snapshot(), BaseCommand(velocity=[0, 0, -3e-3])
    first = quick.step(command, 0.5).tip_position
    quick.step(BaseCommand(velocity=[1e-3, 0, -3e-3]), 0.5)
    quick.restore(start)
    assert np.array_equal(quick.step(command, 0.5).tip_position, first)
