# SPDX-License-Identifier: Apache-2.0
"""Kept responses: equal to direct solves, reciprocal, and the same whatever came before."""

import numpy as np
import pytest
import scipy.sparse as sp

from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.tissue.compliance import Footprint, NodalCompliance
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.response import ResponseTable
from needle_sim_ros.tissue.tiles import Tiles

RADIUS, SPACING = 1e-3, 2e-3
READ_AT = np.array([[0.004, -0.01], [-0.02, -0.05], [0.03, 0.0]])


@pytest.fixture(scope="module")
def model(coarse_scene):
    return TissueModel(coarse_scene())


@pytest.fixture(scope="module")
def factor(model):
    return Factor(model.stiffness)


@pytest.fixture
def compliance(model, factor):
    def make():
        tiles = Tiles(model, (2.2e-3, 16e-3), np.array([0.0, 0.0]))
        return NodalCompliance(model, factor, model.sampling(READ_AT), tiles)

    return make


@pytest.fixture(scope="module")
def footprints(model):
    """A track that leans by 27 deg, so that it crosses tiles both ways."""
    points = np.array([[1.0, -2.0]]) * np.arange(16)[:, None] * SPACING / np.sqrt(5)
    coupling = Coupling(model, RADIUS)
    hats = [coupling.hat(*points[k - 1 : k + 2]) for k in range(1, 15)]
    return [coupling.section(points[0], points[1] / SPACING), *hats]


def direct(model, footprint, component):
    """Solve K u = f for a unit force spread by a footprint; return u on all unknowns."""
    load = np.zeros((model.nodes, 2))
    load[footprint.nodes, component] = footprint.weights
    u = np.zeros(2 * model.nodes)
    u[model.free] = sp.linalg.spsolve(sp.csc_matrix(model.stiffness), load.ravel()[model.free])
    return u.reshape(-1, 2)


def filled(compliance, footprints):
    return with_rows(ResponseTable(compliance), footprints)


def with_rows(table, footprints):
    for footprint in footprints:
        table = table.appended(table.row(footprint))
    return table


def test_responses_are_direct_solves(model, compliance, footprints):
    """Another factorisation (spsolve) of the same K, sampled by the footprints."""
    table = filled(compliance(), footprints)
    readers = model.sampling(READ_AT)
    for row in (0, 7, 14):
        for b in (0, 1):
            u = direct(model, footprints[row], b)
            sampled = np.array([p.weights @ u[p.nodes] for p in footprints]).ravel()
            scale, column = np.abs(u).max(), 2 * row + b
            np.testing.assert_allclose(table.between()[:, column], sampled, atol=1e-10 * scale)
            read = readers @ u.ravel()[model.free]
            np.testing.assert_allclose(table.at_readers()[:, column], read, atol=1e-10 * scale)


@pytest.mark.parametrize("room", [3, 15, 200])
def test_room_is_a_matter_of_memory_only(compliance, footprints, room):
    """Enough of it is never asked for again; more rows than there is room for are no matter."""
    tissue = compliance()
    empty = ResponseTable(tissue, room=room)
    table = with_rows(empty, footprints)
    np.testing.assert_array_equal(table.between(), filled(tissue, footprints).between())
    assert (table.store is empty.store) == (room > len(footprints) - 1)


def test_reciprocity(compliance, footprints):
    """u_a of row k under a force b on row l equals u_b of l under a on k (Maxwell-Betti)."""
    between = filled(compliance(), footprints).between()
    np.testing.assert_allclose(between, between.T, atol=1e-10 * np.abs(between).max())


def test_forces_do_work(compliance, footprints):
    """The compliance between the track points is positive definite."""
    assert np.linalg.eigvalsh(filled(compliance(), footprints).between())[0] > 0


@pytest.mark.parametrize("planned", [0, 6])
def test_same_bits_in_any_order(compliance, footprints, planned):
    """What was asked before, and in which order, must not show in a single bit."""
    forth, back, both, fresh = (compliance() for _ in range(4))
    if planned:
        nodes = np.unique(np.concatenate([p.nodes for p in footprints[:planned]]))
        for each in (forth, back, both, fresh):
            each.prepare(nodes)
    for footprint in footprints:
        forth.ensure(footprint.nodes)
    for footprint in reversed(footprints):
        back.ensure(footprint.nodes)
    both.ensure(np.unique(np.concatenate([p.nodes for p in footprints])))
    tables = [filled(each, footprints) for each in (forth, back, both, fresh)]
    for table in tables[1:]:
        np.testing.assert_array_equal(table.between(), tables[0].between())
        np.testing.assert_array_equal(table.at_readers(), tables[0].at_readers())


def test_tiles_are_computed_once(compliance, footprints):
    kept = compliance()
    assert kept.ensure(footprints[3].nodes) > 0
    before = kept.kept_nodes
    assert kept.ensure(footprints[3].nodes) == 0
    assert kept.kept_nodes == before


def test_progress_counts_the_tiles(compliance, footprints):
    seen = []
    nodes = np.unique(np.concatenate([p.nodes for p in footprints]))
    count = compliance().ensure(nodes, lambda done, total: seen.append((done, total)))
    assert seen == [(i + 1, count) for i in range(count)]


def test_tables_share_but_do_not_disturb_each_other(compliance, footprints):
    """Two tables that grew out of one hold their own rows (snapshots that branch)."""
    kept = compliance()
    trunk = filled(kept, footprints[:5])
    before = trunk.between().copy()
    one = with_rows(trunk, footprints[5:7])
    other = with_rows(trunk, footprints[9:11])
    again = with_rows(trunk, footprints[5:7])
    np.testing.assert_array_equal(trunk.between(), before)
    np.testing.assert_array_equal(one.between(), again.between())
    expected = filled(kept, [*footprints[:5], footprints[9], footprints[10]])
    np.testing.assert_array_equal(other.between(), expected.between())
    assert not np.array_equal(one.between(), other.between())


def test_spread_is_the_transpose_of_sample(compliance, footprints, model):
    """K_PtoS = K_StoP^T: f . sample(u) = spread(f) . u for random f and u."""
    table = filled(compliance(), footprints)
    rng = np.random.default_rng(0)
    forces, field = rng.normal(size=(table.count, 2)), rng.normal(size=(model.nodes, 2))
    work = float((forces * table.sample(field)).sum())
    assert float((table.spread(forces) * field).sum()) == pytest.approx(work, rel=1e-12)
    np.testing.assert_allclose(table.spread(forces).sum(axis=0), forces.sum(axis=0), rtol=1e-12)


def test_displacement_of_the_rows(compliance, footprints):
    """Forces on the first rows move all of them by the matrix's columns."""
    table = filled(compliance(), footprints)
    forces = np.random.default_rng(2).normal(size=(4, 2))
    whole = np.zeros((table.count, 2))
    whole[:4] = forces
    expected = (table.between() @ whole.ravel()).reshape(-1, 2)
    np.testing.assert_allclose(table.displacement(forces), expected, rtol=1e-12)


def test_displacement_of_a_footprint(compliance, footprints, model, factor):
    """Superposition of the kept responses against one solve under all forces."""
    table = filled(compliance(), footprints)
    forces = np.random.default_rng(1).normal(size=(table.count, 2))
    loads = table.spread(forces)
    full = np.zeros(2 * model.nodes)
    full[model.free] = factor.solve(loads.ravel()[model.free])
    place = Footprint(np.array([0, 17, 200, 800]), np.array([0.3, -1.0, 0.5, 2.0]))
    found = table.reading(place).displacement(forces)
    expected = place.weights @ full.reshape(-1, 2)[place.nodes]
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(full).max())
