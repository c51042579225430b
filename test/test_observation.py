# SPDX-License-Identifier: Apache-2.0
"""What an observation shows: shapes and frames in every process, markers, the full field."""

import math

import numpy as np
import pytest

from needle_sim_ros import BaseCommand, Simulator
from needle_sim_ros.geometry import rotation_matrix
from needle_sim_ros.interaction.process import Process

MARKERS = [[-0.003, 0.0, -0.005], [0.0004, 0.0, -0.02], [0.02, 0.0, -0.06], [0.06, 0.0, -0.03]]
WAYS = {
    "quasi_static": {},
    "reduced": {"solver.dynamics": "newmark", "solver.modes": 20, "solver.time_step": 0.05},
    "newmark": {"solver.dynamics": "newmark", "solver.time_step": 0.05},
}


@pytest.fixture(scope="module", params=WAYS)
def visited(request, coarse_scene, drive):
    """A simulator and one observation, with its snapshot, of each process."""
    changes = {"markers": MARKERS, "needle.tip.deviation_angle": 0.1, **WAYS[request.param]}
    sim = Simulator(coarse_scene(changes))
    seen = {}
    for velocity, duration in (((0, 0, -3e-3), 9.0), ((0, 0, 0), 0.5), ((1e-3, 0, 3e-3), 1.0)):
        for _ in range(round(duration / 0.05)):
            (o,) = drive(sim, 0.05, velocity)
            seen[o.process] = o, sim.snapshot()
    assert set(seen) == set(Process)
    return sim, seen


SHAPES = {
    "tip_position": (3,),
    "tip_deflection": (3,),
    "tip_slope": (2,),
    "base_position": (3,),
    "base_orientation": (4,),
    "base_force": (3,),
    "base_torque": (3,),
    "marker_positions": (4, 3),
    "marker_displacements": (4, 3),
}


@pytest.mark.parametrize("process", Process)
def test_shapes(visited, process):
    """Three components always; y is 0 in a 2D scene; as many points as forces."""
    o, _ = visited[1][process]
    for name, shape in SHAPES.items():
        value = getattr(o, name)
        assert isinstance(value, np.ndarray) and value.shape == shape, name
        assert np.isfinite(value).all(), name
    for name in ("time", "insertion_depth", "friction_force", "tip_force"):
        assert isinstance(getattr(o, name), float), name
    count = len(o.contact_points)
    assert o.contact_points.shape == o.contact_forces.shape == (count, 3)
    assert count == {Process.FREE: 0, Process.CONTACT: 1}.get(process, count)
    if process in (Process.INSERTION, Process.HOLD, Process.RETRACTION):
        assert count >= o.insertion_depth / 2e-3
    for vectors in (o.contact_points, o.contact_forces, o.marker_positions, o.needle_points):
        assert not vectors[:, 1].any()
    assert o.tip_deflection[1:].tolist() == [0.0, 0.0]
    assert o.base_force[1] == 0.0 and not o.base_torque[[0, 2]].any()


@pytest.mark.parametrize("process", Process)
def test_the_needle_s_polyline(visited, process):
    """From the base to the tip, of the needle's length, leaving along the base's z."""
    o, _ = visited[1][process]
    points = o.needle_points
    assert len(points) >= 10
    np.testing.assert_allclose(points[0], o.base_position, atol=1e-15)
    np.testing.assert_allclose(points[-1], o.tip_position, atol=1e-15)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert length == pytest.approx(0.13, rel=1e-3)
    axis = rotation_matrix(o.base_orientation)[:, 2]
    first = points[1] - points[0]
    assert first @ axis / np.linalg.norm(first) > 0.9999


@pytest.mark.parametrize("process", Process)
def test_the_tip_stands_off_the_axis_by_its_deflection(visited, process):
    """tip = base + R (deflection + L e_z)."""
    o, _ = visited[1][process]
    rotation = rotation_matrix(o.base_orientation)
    expected = o.base_position + rotation @ (o.tip_deflection + np.array([0, 0, 0.13]))
    np.testing.assert_allclose(o.tip_position, expected, atol=1e-15)


@pytest.mark.parametrize("process", Process)
def test_slope_is_the_end_of_the_polyline(visited, process):
    """d deflection / d s at the tip, against the last piece of the drawn needle."""
    o, _ = visited[1][process]
    rotation = rotation_matrix(o.base_orientation)
    last = (o.needle_points[-1] - o.needle_points[-2]) @ rotation
    assert o.tip_slope[0] == pytest.approx(last[0] / last[2], abs=3e-3)
    assert o.tip_slope[1] == 0.0


@pytest.mark.parametrize("process", Process)
def test_markers_move_with_the_field(visited, process):
    """The markers' kept responses against the full field, a solve of every unknown."""
    sim, seen = visited
    o, snapshot = seen[process]
    sim.restore(snapshot)
    np.testing.assert_allclose(sim.tissue_displacement(MARKERS), o.marker_displacements, atol=1e-11)
    np.testing.assert_allclose(o.marker_positions, MARKERS + o.marker_displacements, atol=1e-17)
    np.testing.assert_allclose(o.marker_displacements[3], 0.0, atol=1e-17)  # on a held face
    if process is Process.INSERTION:
        assert o.marker_displacements[0, 2] < -1e-4  # dragged down beside the needle


@pytest.mark.parametrize("process", Process)
def test_held_faces_stand_still(visited, process):
    """u = 0 on the left, right and bottom, whatever happens; the top moves."""
    sim, seen = visited
    sim.restore(seen[process][1])
    z, x = np.linspace(-0.08, 0, 9), np.linspace(-0.06, 0.06, 9)
    left = np.column_stack([np.full(9, -0.06), np.zeros(9), z])
    bottom = np.column_stack([x, np.zeros(9), np.full(9, -0.08)])
    for face in (left, left * [-1, 1, 1], bottom):
        np.testing.assert_array_equal(sim.tissue_displacement(face), 0.0)
    top = sim.tissue_displacement([[0.002, 0, 0], [-0.01, 0, 0]])
    if process in (Process.CONTACT, Process.INSERTION):
        assert np.abs(top[:, 2]).min() > 1e-5


def test_outside_the_tissue_there_is_no_displacement(simulator, drive):
    sim = simulator()
    drive(sim, 8.0, (0, 0, -3e-3))
    found = sim.tissue_displacement(
        [[0, 0, 0.001], [0.07, 0, -0.01], [0, 0, -0.081], [0, 0, -0.01]]
    )
    assert np.isnan(found[:3]).all() and np.isfinite(found[3]).all()
    assert sim.tissue_displacement(np.empty((0, 3))).shape == (0, 3)


def test_no_markers_no_rows(simulator):
    o = simulator().step(BaseCommand(velocity=[0, 0, -0.05]), 0.5)
    assert o.marker_positions.shape == o.marker_displacements.shape == (0, 3)


def test_markers_on_the_corners_of_the_tissue(coarse_scene, drive):
    corners = [[x, 0.0, z] for x in (-0.06, 0.06) for z in (-0.08, 0.0)]
    sim = Simulator(coarse_scene({"markers": corners}))
    np.testing.assert_array_equal(drive(sim, 6.0, (0, 0, -3e-3))[-1].marker_displacements, 0.0)


def test_old_observations_stay_what_they_were(simulator, drive):
    """Members first read after the simulation went on show the tick they belong to."""
    sim = simulator({"markers": MARKERS})
    first, *_ = drive(sim, 0.05, (0, 0, -0.06))
    drive(sim, 0.3, (0, 0, -0.06))
    o = sim.observe()
    eager = {name: np.copy(getattr(o, name)) for name in ("base_force", "marker_displacements")}
    twin = simulator({"markers": MARKERS})
    drive(twin, 0.35, (0, 0, -0.06))
    late = twin.observe()
    drive(twin, 0.2, (0, 0, -0.06))
    for name, value in eager.items():
        np.testing.assert_array_equal(getattr(late, name), value)
    assert first.process is Process.FREE and not first.base_force.any()


def test_a_base_that_leans_reports_in_its_own_frame(simulator, drive):
    """Pushing in along an inclined axis gives force z < 0 in the base frame."""
    direction = np.array([-math.sin(0.3), 0.0, -math.cos(0.3)])
    sim = simulator(
        {
            "base.position": (-0.132 * direction).tolist(),
            "base.orientation": [math.cos(0.15), 0.0, -math.sin(0.15), 0.0],
            "protocol": [{"duration": 5.0, "velocity": (3e-3 * direction).tolist()}],
        }
    )
    o = drive(sim, 5.0, 3e-3 * direction)[-1]
    assert o.base_force[2] < -0.3
    assert abs(o.base_force[0]) < 0.1 * abs(o.base_force[2])
    pushed = o.contact_forces.sum(axis=0)
    assert pushed @ direction == pytest.approx(-o.base_force[2], rel=1e-9)
