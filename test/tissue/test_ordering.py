# SPDX-License-Identifier: Apache-2.0
"""Large grids: the elimination order, and responses that are solved for when asked."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from needle_sim_ros import BaseCommand, Scene, Simulator
from needle_sim_ros.tissue import build
from needle_sim_ros.tissue.direct import DirectCompliance
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel
from needle_sim_ros.tissue.ordering import unknowns_order


def grid(side, element="quad1"):
    return Scene.load(
        "gao2016",
        {
            "solver.dynamics": "quasi_static",
            "solver.track_spacing": 4e-3,
            "tissue.mesh.uniform": True,
            "tissue.mesh.element": element,
            "tissue.mesh.spacing_across": 0.12 / (side - 1),
            "tissue.mesh.spacing_along": 0.08 / (side - 1),
        },
    )


def ordered(model):
    return unknowns_order(model.stiffness, model.coordinates[:, model.free // 2])


@pytest.mark.parametrize("element", ["quad1", "quad2", "tri1", "tri2"])
def test_each_unknown_once_and_the_solution_the_same(element):
    model = TissueModel(grid(41, element))
    order = ordered(model)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(model.free)))
    right = np.random.default_rng(1).normal(size=(len(order), 2))
    answer = Factor(model.stiffness, order).solve(right)
    plain = Factor(model.stiffness).solve(right)
    np.testing.assert_allclose(answer, plain, atol=1e-10 * np.abs(plain).max())


def test_less_fill_than_minimum_degree_on_a_large_uniform_grid():
    model = TissueModel(grid(161))
    order = ordered(model)
    settings = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    matrix = model.stiffness.tocsc()
    degree = splu(matrix, permc_spec="MMD_AT_PLUS_A", **settings)
    dissected = splu(matrix[order][:, order].tocsc(), permc_spec="NATURAL", **settings)
    assert dissected.nnz < 0.9 * degree.nnz


def test_direct_responses_give_the_same_run(monkeypatch):
    runs = []
    for most in (build._MOST_KEPT, 0):
        monkeypatch.setattr(build, "_MOST_KEPT", most)
        simulator = Simulator(grid(33))
        assert isinstance(simulator._dynamics.compliance, DirectCompliance) == (most == 0)
        command = BaseCommand(velocity=[0.0, 0.0, -0.02])
        runs.append([simulator.step(command, 0.05) for _ in range(40)])
    for one, other in zip(*runs, strict=True):
        np.testing.assert_allclose(one.base_force, other.base_force, atol=1e-9)
        np.testing.assert_allclose(one.tip_deflection, other.tip_deflection, atol=1e-12)
        np.testing.assert_allclose(one.marker_displacements, other.marker_displacements, atol=1e-12)
    assert one.insertion_depth > 0.02
