# SPDX-License-Identifier: Apache-2.0
"""What the answer must not depend on: step size, track spacing, mesh, presliding, tolerance."""

import numpy as np
import pytest

from needle_sim_ros import Simulator

DOWN, UP, ASIDE = (0, 0, -3e-3), (0, 0, 3e-3), (2e-3, 0, 0)
WEAKENING = {"interaction.friction.static": 24.0, "interaction.friction.kinetic": 16.0}
PARTS = [(10.0, DOWN), (2.0, (0, 0, 0)), (1.0, ASIDE), (3.0, UP)]


def trace(sim, drive, dt):
    """Every 0.1 s: depth, friction, axial and lateral base force, deflection."""
    rows = []
    for duration, velocity in PARTS:
        every = round(0.1 / dt)
        for o in drive(sim, duration, velocity, dt=dt)[every - 1 :: every]:
            rows.append(
                (
                    o.insertion_depth,
                    o.friction_force,
                    o.base_force[2],
                    o.base_force[0],
                    o.tip_deflection[0],
                )
            )
    return np.array(rows)


def relative(one, other):
    """Largest differences, each by the largest magnitude of its quantity in the run."""
    return np.abs(one - other).max(axis=0) / np.abs(other).max(axis=0)


@pytest.fixture(scope="module")
def fine(coarse_scene, drive):
    return trace(Simulator(coarse_scene()), drive, 3.125e-3)


# when the friction turns round, within 10 ms of base travel, it shows that in time
REVERSAL = slice(130, 137)


def test_a_quarter_of_the_step(simulator, drive, fine):
    """dt 12.5 ms to 3.125 ms: friction and all else within 1 %, at every instant."""
    assert relative(trace(simulator(), drive, 0.0125), fine).max() < 0.01


@pytest.mark.parametrize("dt", [0.05, 0.1])
def test_long_ticks(simulator, drive, fine, dt):
    """Up to 0.3 mm of advance a tick: within 1 %, but while the friction turns round."""
    found = trace(simulator(), drive, dt)
    assert relative(np.delete(found, REVERSAL, 0), np.delete(fine, REVERSAL, 0)).max() < 0.01
    assert relative(found, fine).max() < 0.1


def test_twice_the_presliding_stiffness(simulator, drive, fine):
    """Stiff beside the tissue: doubling it changes nothing by 1 %, but the 14 um of base
    travel over which the friction turns round."""
    sim = simulator({"interaction.friction.presliding_stiffness": 2e6})
    found = trace(sim, drive, 3.125e-3)
    assert relative(np.delete(found, REVERSAL, 0), np.delete(fine, REVERSAL, 0)).max() < 2e-3
    assert relative(found, fine).max() < 0.02


@pytest.mark.parametrize("tolerance", [1e-12, 1e-8])
def test_the_solver_s_tolerance(simulator, drive, tolerance):
    """Two decades up and down change nothing: the contact solve is direct."""
    usual = trace(simulator(), drive, 0.05)
    sim = simulator({"solver.tolerance": tolerance})
    assert relative(trace(sim, drive, 0.05), usual).max() < 1e-6


def test_the_end_of_a_hold(simulator, drive):
    """After 10 s of rest the answer is the same from steps of 20 ms and of 1 ms."""
    ends = []
    for dt in (0.02, 0.001):
        sim = simulator()
        drive(sim, 8.0, DOWN, dt=0.02)
        drive(sim, 0.4, (0, 0, 0), dt=dt)
        o = drive(sim, 9.6, dt=0.02)[-1]
        ends.append([o.insertion_depth, o.base_force[2], o.base_force[0], o.tip_deflection[0]])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.01)


# a small block, 15 mm deep: the meshes can be fine
SMALL = {
    "needle.tip.deviation_angle": 0.0,
    "tissue.size": [0.05, 0.03],
    "protocol": [{"duration": 25.0 / 3, "velocity": DOWN}],
}


def inserted(coarse_scene, drive, changes):
    """15 mm deep, then 2 mm aside: (axial force, lateral force, deflection, depth)."""
    sim = Simulator(coarse_scene({**SMALL, **changes}))
    drive(sim, 25.0 / 3, DOWN, dt=25.0 / 3 / 100)
    o = drive(sim, 1.0, ASIDE, dt=0.1)[-1]
    return np.array([o.base_force[2], o.base_force[0], o.tip_deflection[0], o.insertion_depth])


@pytest.fixture(scope="module")
def refined(coarse_scene, drive):
    """Half the spacing of mesh and track of the finest below."""
    spacings = {"tissue.mesh.spacing_across": 0.5e-3, "tissue.mesh.spacing_along": 1e-3}
    return inserted(coarse_scene, drive, {**spacings, "solver.track_spacing": 0.5e-3})


def test_refining_mesh_and_track_converges(coarse_scene, drive, refined):
    """4, 2 and 1 mm against half a millimetre: within 2, 0.8 and 0.2 %, 4 times less for half."""
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        changes = {"tissue.mesh.spacing_across": h / 2, "tissue.mesh.spacing_along": h}
        found = inserted(coarse_scene, drive, {**changes, "solver.track_spacing": h})
        errors.append(np.abs(found - refined) / np.abs(refined))
    assert errors[0].max() < 0.02
    assert errors[1].max() < 8e-3 and errors[2].max() < 2e-3
    assert errors[2].max() < 0.3 * errors[1].max()
    # axial force and depth
    assert errors[1][[0, 3]].max() < 1e-3 and errors[2][[0, 3]].max() < 1e-3


def test_refining_the_mesh_alone_changes_little(coarse_scene, drive):
    """With the forces spread over the needle's width and the track's hats the mesh is only
    a means: halving it once more, at a fixed track, changes less than 0.5 %."""
    answers = [
        inserted(
            coarse_scene,
            drive,
            {"tissue.mesh.spacing_across": h / 2, "tissue.mesh.spacing_along": h},
        )
        for h in (2e-3, 1e-3)
    ]
    np.testing.assert_allclose(answers[0], answers[1], rtol=0.005)


@pytest.mark.parametrize(("element", "error"), [("quad1", 0.016), ("tri2", 0.02)])
def test_other_elements_agree(coarse_scene, drive, refined, element, error):
    """Other elements on a 1 mm mesh, with a track of 2 mm, which is 0.7 % off itself."""
    changes = {
        "tissue.mesh.element": element,
        "tissue.mesh.spacing_across": 1e-3,
        "tissue.mesh.spacing_along": 1e-3,
    }
    found = inserted(coarse_scene, drive, changes)
    same = inserted(coarse_scene, drive, {**changes, "tissue.mesh.element": "quad2"})
    np.testing.assert_allclose(found, same, rtol=error)
    np.testing.assert_allclose(found, refined, rtol=error)


def test_short_strokes_and_a_hold_in_ticks_of_a_second(simulator, drive):
    """Ten times the time in which friction recovers: within 0.5 % of ticks a sixteenth as long."""
    strokes = (-20e-3, 4e-3, -4e-3, 2e-3, -2e-3, 0.0, 0.0, 0.0)
    found = []
    for parts in (1, 16):
        sim = simulator(WEAKENING)
        while sim.observe().insertion_depth < 0.02:
            drive(sim, 0.1, DOWN, dt=0.1)
        ends = [drive(sim, 1.0, (0, 0, stroke), dt=1 / parts)[-1] for stroke in strokes]
        found.append(np.array([[end.friction_force] for end in ends]))
    assert relative(*found).max() < 0.005
