# SPDX-License-Identifier: Apache-2.0
"""The assembled tissue: which nodes are held, its weight, its linear answer."""

import numpy as np
import pytest

from needle_sim_ros import SceneError
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.model import TissueModel


@pytest.mark.parametrize(
    "faces", [["bottom"], ["left", "right"], ["left", "right", "bottom"], ["left"]]
)
def test_nodes_of_the_fixed_faces_are_held_and_no_others(coarse_scene, faces):
    model = TissueModel(coarse_scene({"tissue.fixed": faces}))
    x, z = model.coordinates
    on = {"left": x == -0.06, "right": x == 0.06, "bottom": z == -0.08}
    held = np.any([on[face] for face in faces], axis=0)
    free = np.zeros(2 * model.nodes, dtype=bool)
    free[model.free] = True
    np.testing.assert_array_equal(free, np.repeat(~held, 2))


def test_the_weight(coarse_scene):
    """rho w h t = 1000 x 0.12 x 0.08 x 0.024 kg, with nothing held but the bottom's nodes."""
    model = TissueModel(coarse_scene({"tissue.fixed": ["bottom"]}))
    rigid = np.zeros(2 * model.nodes)
    rigid[0::2] = 1.0
    moving = rigid[model.free]
    # what the bottom's nodes carry: their rows of the consistent mass
    total = 1000 * 0.12 * 0.08 * 0.024
    assert 0.9 * total < moving @ (model.mass @ moving) < total
    full = model.mass.sum()
    assert full == pytest.approx(2 * (moving @ (model.mass @ moving)), rel=1e-12)


def test_stiffness_scales_with_thickness_and_modulus(coarse_scene):
    one = TissueModel(coarse_scene())
    other = TissueModel(coarse_scene({"tissue.thickness": 0.048, "tissue.youngs_modulus": 45e3}))
    assert abs(other.stiffness - 6 * one.stiffness).max() < 1e-12 * abs(other.stiffness).max()
    assert abs(other.mass - 2 * one.mass).max() < 1e-12 * abs(other.mass).max()


def test_more_faces_held_make_it_stiffer(coarse_scene):
    """The work of the same load falls with every face that is held."""
    works = []
    for faces in (["bottom"], ["bottom", "left"], ["bottom", "left", "right"]):
        model = TissueModel(coarse_scene({"tissue.fixed": faces}))
        load = model.sampling(np.array([[0.0, -0.02]])).T @ np.array([0.3, -1.0])
        works.append(load @ Factor(model.stiffness).solve(load))
    assert works[0] > 1.001 * works[1] > 1.001 * 1.001 * works[2]


def test_sampling_is_linear_in_the_nodes(coarse_scene):
    """The rows of the matrix hold the shape functions of the free unknowns."""
    model = TissueModel(coarse_scene())
    point = np.array([[0.013, -0.021]])
    nodes, values, _ = model.shape_functions(point)
    u = np.random.default_rng(0).normal(size=2 * model.nodes)
    u[np.setdiff1d(np.arange(2 * model.nodes), model.free)] = 0.0
    expected = values[0] @ u.reshape(-1, 2)[nodes[0]]
    np.testing.assert_allclose(model.sampling(point) @ u[model.free], expected, rtol=1e-12)


def test_a_floating_tissue_is_refused(coarse_scene):
    with pytest.raises(SceneError, match=r"tissue\.fixed"):
        coarse_scene({"tissue.fixed": []})
