# SPDX-License-Identifier: Apache-2.0
"""The baseline does what the paper prints: Eqs. (4), (6), (9) to (11) and (18) to (24)."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.sparse.linalg import eigsh

from needle_sim_ros import BaseCommand, CommandError, Scene, SceneError
from needle_sim_ros.benchmark import paper_needle
from needle_sim_ros.benchmark.paper import PaperSimulator
from needle_sim_ros.benchmark.paper_mesh import UniformMesh
from needle_sim_ros.benchmark.paper_tissue import Coupling
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.needle import beam

STILL = BaseCommand()
FAST = {  # the paper's insertion, eight times as fast and half as deep
    "protocol": [
        {"duration": 1.6, "velocity": [0.0, 0.0, -0.024]},
        {"duration": 0.8, "velocity": [0.0, 0.0, 0.0]},
        {"duration": 1.6, "velocity": [0.0, 0.0, 0.024]},
    ],
    "interaction.friction.kinetic": 12.0,
    "interaction.cutting": {"force": 0.3, "relaxation_time": 1.5},
    "interaction.puncture.force": 0.5,
    "markers": [],
}


def run(simulator):
    scene = simulator.scene
    return [
        simulator.step(segment.command(), scene.solver.time_step)
        for segment in scene.protocol
        for _ in range(round(segment.duration / scene.solver.time_step))
    ]


@pytest.fixture(scope="module")
def states():
    return run(PaperSimulator(Scene.load("gao2016", FAST), nodes=300))


class TestNeedle:
    """Eqs. (6) and (7)."""

    def test_flexibility_is_equation_6_line_by_line(self):
        rigidity = 1.7e-3
        length = np.array([0.02, 0.05, 0.06, 0.11])
        force = np.array([0.3, -0.2, 0.5, 0.1])
        k = length**3 / (3 * rigidity)
        expected = [
            k[m] * force[m:].sum()
            + sum(
                (length[m] - length[j]) * 3 * k[j] / (2 * length[j]) * force[j:].sum()
                for j in range(m)
            )
            for m in range(4)
        ]
        found = paper_needle.printed_flexibility(length, rigidity) @ force
        np.testing.assert_allclose(found, expected, rtol=1e-14)

    def test_one_node_is_the_cantilever(self):
        found = paper_needle.printed_flexibility([0.13], 2.0)
        np.testing.assert_allclose(found, [[0.13**3 / 6.0]], rtol=1e-15)

    def test_defect_grows_with_the_number_of_nodes(self):
        ratios = [paper_needle.tip_deflection_ratio(n) for n in range(1, 61)]
        assert ratios[0] == pytest.approx(1.0, rel=1e-14)
        assert ratios[1] == pytest.approx(1.2, abs=0.01)
        assert ratios[59] == pytest.approx(11.0, abs=0.1)
        assert np.all(np.diff(ratios) > 0)

    def test_defect_with_nodes_over_the_whole_needle(self):
        # The sum of Eq. (6) over even nodes has the closed form 1 + (n^2 - 1) / 8n.
        for n in (1, 2, 5, 60):
            ratio = paper_needle.tip_deflection_ratio(n, inserted=1.0)
            assert ratio == pytest.approx(1 + (n**2 - 1) / (8 * n), rel=1e-12)

    def test_printed_matrix_breaks_reciprocity_and_the_exact_one_keeps_it(self):
        length = np.linspace(0.01, 0.1, 10)
        printed = paper_needle.printed_flexibility(length, 1.0)
        exact = beam.flexibility(length, length, 1.0)
        assert np.abs(printed - printed.T).max() > 0.1 * np.abs(printed).max()
        np.testing.assert_array_equal(exact, exact.T)


class TestMesh:
    """Where the needle crosses element edges (Fig. 8)."""

    def test_paper_size(self):
        mesh = UniformMesh(0.120, 0.080, 1061)
        assert mesh.points.shape == (2, 1080)
        assert np.linalg.det(edges(mesh)).min() > 0
        area = np.linalg.det(edges(mesh)).sum() / 2
        assert area == pytest.approx(0.120 * 0.080, rel=1e-13)

    @example([0.0, -2e-16], [-0.0625, -0.03125])
    @given(
        st.lists(st.floats(-0.059, 0.059), min_size=2, max_size=2),
        st.lists(st.floats(-0.079, -0.001), min_size=2, max_size=2),
    )
    def test_crossings_lie_on_their_edges_and_miss_none(self, x, z):
        mesh = UniformMesh(0.120, 0.080, 200)
        start, end = np.array([x[0], z[0]]), np.array([x[1], z[1]])
        reach = float(np.linalg.norm(end - start))
        nodes = mesh.crossings(start, end, 0.0, -1.0)
        for node in nodes:
            first, second = mesh.points[:, node.first], mesh.points[:, node.second]
            on_edge = (1 - node.weight) * first + node.weight * second
            np.testing.assert_allclose(on_edge, node.point, atol=2e-5)
        # Between two crossings the needle stays inside one element, but within 1e-3 of a cell
        # from a mesh node, where crossings count as one.
        along = np.array([0.0, *(node.arclength for node in nodes), reach])
        for near, far in itertools.pairwise(along):
            if far - near > 1e-4:
                inner = near + (far - near) * np.array([[0.1], [0.5], [0.9]])
                places = start + inner / reach * (end - start)
                (element,), _ = mesh.locate(places[1])
                corner = mesh.points[:, element].T
                weights = np.linalg.solve((corner[1:] - corner[0]).T, (places - corner[0]).T)
                # Along an edge, either element will do.
                assert min(weights.min(), (1 - weights.sum(axis=0)).min()) > -1e-9

    def test_pieces_give_the_same_nodes_as_the_whole(self):
        mesh = UniformMesh(0.120, 0.080, 1061)
        start, end = np.array([0.0003, 0.0]), np.array([0.011, -0.06])
        whole = mesh.crossings(start, end, 0.0, 0.0)
        pieces, length = [], float(np.linalg.norm(end - start))
        for k in range(500):
            a, b = start + (end - start) * k / 500, start + (end - start) * (k + 1) / 500
            last = pieces[-1].arclength if pieces else 0.0
            pieces += mesh.crossings(a, b, length * k / 500, last)
        assert [(n.first, n.second) for n in pieces] == [(n.first, n.second) for n in whole]


def edges(mesh):
    corner = mesh.points[:, mesh.triangles]
    return np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]]).transpose(2, 0, 1)


class TestCoupling:
    """Eqs. (18) to (21)."""

    @pytest.fixture
    def tissue(self):
        return PaperSimulator(Scene.load("gao2016"), nodes=300).tissue

    @pytest.fixture
    def nodes(self, tissue):
        return tissue.mesh.crossings(np.array([0.001, 0.0]), np.array([0.02, -0.05]), 0.0, -1.0)

    def test_rows_of_s_to_p_add_up_to_one(self, nodes):
        coupling = Coupling(nodes)
        np.testing.assert_allclose(coupling.to_needle.sum(axis=1), 1.0, rtol=1e-15)
        assert (coupling.to_needle >= 0).all()
        assert (np.count_nonzero(coupling.to_needle, axis=1) <= 2).all()

    def test_p_to_s_keeps_the_force_and_its_power(self, tissue, nodes):
        rng = np.random.default_rng(5)
        forces = rng.normal(size=(len(nodes), 2))
        moved = rng.normal(size=tissue.stiffness.shape[0])
        coupling = Coupling(nodes)
        load = tissue.spread(coupling, forces)
        np.testing.assert_allclose(load.reshape(-1, 2).sum(axis=0), forces.sum(axis=0), rtol=1e-12)
        assert load @ moved == pytest.approx(np.sum(forces * tissue.at(coupling, moved)))

    def test_needle_node_moves_with_its_edge(self, tissue, nodes):
        moved = np.random.default_rng(6).normal(size=tissue.stiffness.shape[0])
        by_edge = tissue.at(Coupling(nodes), moved)
        by_element = tissue.inside(np.array([node.point for node in nodes]), moved)
        np.testing.assert_allclose(by_edge, by_element, atol=1e-9)


class TestTissue:
    """Eqs. (1) to (5)."""

    def test_patch(self):
        changes = {"tissue.poisson_ratio": 0.0, "tissue.fixed": ["bottom"]}
        scene = Scene.load("gao2016", changes | {"solver.dynamics": "quasi_static"})
        tissue = PaperSimulator(scene, nodes=300).tissue
        mesh, traction = tissue.mesh, 120.0
        share = np.full(mesh.columns, mesh.cell[0])
        share[[0, -1]] /= 2
        load = np.zeros((mesh.points.shape[1], 2))
        load[mesh.face("top"), 1] = traction * share * scene.tissue.thickness
        moved = tissue.solve(np.delete(load, mesh.face("bottom"), axis=0).ravel())
        points = np.random.default_rng(7).uniform([-0.06, -0.08], [0.06, 0.0], (50, 2))
        exact = np.zeros((50, 2))
        exact[:, 1] = traction / scene.tissue.youngs_modulus * (points[:, 1] + 0.08)
        np.testing.assert_allclose(tissue.inside(points, moved), exact, atol=1e-15)

    @pytest.fixture
    def undamped(self):
        return PaperSimulator(Scene.load("gao2016", {"tissue.damping.beta": 0.0}), nodes=150)

    def test_newmark_keeps_the_energy(self, undamped):
        tissue = undamped.tissue
        tissue.velocity = 1e-3 * np.random.default_rng(8).normal(size=tissue.stiffness.shape[0])

        def energy():
            u, v = tissue.displacement, tissue.velocity
            return u @ (tissue.stiffness @ u) / 2 + v @ (tissue.mass @ v) / 2

        start = energy()
        for _ in range(300):
            undamped.step(STILL, 0.01)
        assert energy() == pytest.approx(start, rel=1e-9)

    def test_newmark_has_the_period_of_the_trapezoidal_rule(self, undamped):
        tissue, step = undamped.tissue, 0.01
        value, modes = eigsh(tissue.stiffness, 1, tissue.mass, sigma=0.0)
        # Too small to reach the needle.
        omega, mode = math.sqrt(value[0]), 1e-4 * modes[:, 0]
        tissue.displacement, tissue.acceleration = mode, -value[0] * mode
        for _ in range(40):
            undamped.step(STILL, step)
        turned = 40 * 2 * math.atan(omega * step / 2)
        amplitude = np.abs(mode).max()
        np.testing.assert_allclose(
            tissue.displacement, math.cos(turned) * mode, atol=1e-8 * amplitude
        )


class TestProcesses:
    """Sections 3 and 4.4."""

    def test_order(self, states):
        seen = [state.process for state in states]
        order = [p for k, p in enumerate(seen) if k == 0 or seen[k - 1] is not p]
        assert order[:5] == [
            Process.FREE,
            Process.CONTACT,
            Process.INSERTION,
            Process.HOLD,
            Process.RETRACTION,
        ]
        assert order[-1] is Process.FREE

    def test_contact_ends_at_the_puncture_force(self, states):
        contact = [s.tip_force for s in states if s.process is Process.CONTACT]
        assert max(contact[:-1]) < 0.5 <= contact[-1]
        assert np.all(np.diff(contact) > 0)

    def test_contact_is_the_equilibrium_of_equation_11(self, states):
        scene = Scene.load("gao2016")
        spring = 3 * scene.needle.flexural_rigidity / scene.needle.length**3
        for state in states:
            if state.process is Process.CONTACT:
                # The force that bends the needle is the one the tissue answers with.
                assert state.tip_deflection[0] != 0
                assert state.base_force[0] == pytest.approx(spring * state.tip_deflection[0])

    def test_axial_force_is_friction_and_cutting(self, states):
        sign = {Process.INSERTION: 1, Process.HOLD: 1, Process.RETRACTION: -1}
        for state in states:
            if state.process in sign:
                expected = sign[state.process] * 12.0 * state.insertion_depth
                assert state.friction_force == pytest.approx(expected, rel=1e-12)
                assert state.base_force[2] == -(state.friction_force + state.tip_force)
            if state.process is Process.INSERTION:
                assert state.tip_force == 0.3
            if state.process is Process.RETRACTION:
                assert state.tip_force == 0.0

    def test_cutting_relaxes_in_the_hold(self, states):
        held = [s.tip_force for s in states if s.process is Process.HOLD]
        assert held[-1] == pytest.approx(0.3 * math.exp(-len(held) * 0.01 / 1.5), rel=1e-12)

    def test_all_comes_to_rest_after_the_needle_left(self, states):
        assert states[-1].insertion_depth == 0.0
        assert states[-1].needle_nodes == 0

    def test_tissue_carries_what_the_needle_gives(self):
        scene = Scene.load("gao2016", FAST | {"solver.dynamics": "quasi_static"})
        simulator = PaperSimulator(scene, nodes=300)
        for _ in range(100):
            state = simulator.step(scene.protocol[0].command(), 0.01)
        assert state.needle_nodes > 5
        tissue = simulator.tissue
        load = (tissue.stiffness @ tissue.displacement).reshape(-1, 2).sum(axis=0)
        assert load[1] == pytest.approx(state.base_force[2], rel=1e-10)
        assert load[0] == pytest.approx(-state.base_force[0], abs=1e-10)

    def test_markers_follow_the_needle(self, states):
        scene = Scene.load("gao2016", FAST | {"markers": [[0.004, 0.0, -0.01]]})
        run_with_marker = run(PaperSimulator(scene, nodes=300))
        deepest = [s for s in run_with_marker if s.process is Process.INSERTION][-1]
        assert deepest.marker_displacements.shape == (1, 3)
        assert -2e-3 < deepest.marker_displacements[0, 2] < -1e-4
        assert deepest.marker_displacements[0, 1] == 0.0
        assert states[-1].marker_displacements.shape == (0, 3)


class TestRefusals:
    """What the paper's algorithm does not cover is said."""

    def test_regions(self):
        region = {"name": "hard", "shape": "ellipsoid", "center": [0, 0, -0.03]}
        scene = Scene.load("gao2016", {"tissue.regions": [{**region, "size": [0.01] * 3}]})
        with pytest.raises(SceneError, match=r"tissue\.regions"):
            PaperSimulator(scene)

    @pytest.mark.parametrize("dt", [0.0, 0.005, math.nan])
    def test_time_step(self, dt):
        simulator = PaperSimulator(Scene.load("gao2016"), nodes=150)
        with pytest.raises(CommandError, match="must be"):
            simulator.step(STILL, dt)
        assert simulator.time == 0.0
