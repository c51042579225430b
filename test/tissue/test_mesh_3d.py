# SPDX-License-Identifier: Apache-2.0
"""The tissue in 3D: hexahedra, where points lie in them, and what they answer."""

import math

import numpy as np
import pytest
import scipy.sparse as sp

from needle_sim_ros import Scene, SceneError
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.interfaces import fitted
from needle_sim_ros.tissue.material import lame_parameters
from needle_sim_ros.tissue.mesh import build_mesh
from needle_sim_ros.tissue.model import TissueModel

SIZE = (0.06, 0.05, 0.04)
LOW, HIGH = np.array([-0.03, -0.025, -0.04]), np.array([0.03, 0.025, 0.0])


@pytest.fixture(scope="module")
def block():
    """Make a coarse block with a needle that comes down at an angle (rad) about y, then x."""

    def make(changes=None, about_y=0.0, about_x=0.0):
        from needle_sim_ros.geometry import from_rotation_vector, multiply, rotation_matrix

        down = np.array([1.0, 0.0, 0.0, 0.0])
        lean = multiply(
            from_rotation_vector(np.array([0.0, about_y, 0.0])),
            from_rotation_vector(np.array([about_x, 0.0, 0.0])),
        )
        quaternion = multiply(lean, down)
        axis = rotation_matrix(quaternion)[:, 2]
        settings = {
            "name": "block",
            "dimension": 3,
            "tissue": {
                "size": list(SIZE),
                "youngs_modulus": 15e3,
                "poisson_ratio": 0.4,
                "mesh": {"spacing_across": 4e-3, "growth": 2.0},
            },
            "needle": {"length": 0.1, "radius": 1e-3, "youngs_modulus": 2e11},
            "solver": {"track_spacing": 5e-3},
            "base": {
                "position": (-0.11 * axis).tolist(),
                "orientation": quaternion.tolist(),
            },
            "protocol": [{"duration": 10.0, "velocity": (3.5e-3 * axis).tolist()}],
        }
        return Scene.from_dict(settings, changes)

    return make


def random_points(count=800):
    return np.random.default_rng(0).uniform(LOW, HIGH, (count, 3))


LEANS = [(0.0, 0.0), (0.3, 0.0), (0.2, -0.25)]


@pytest.mark.parametrize("lean", LEANS)
def test_points_are_found(block, lean):
    """What locate() finds, mapped back to space, is the point; corners and middles too."""
    grid = build_mesh(block(None, *lean))
    corners = grid.mesh.p
    middles = corners[:, grid.mesh.t].mean(axis=1).T
    for points in (random_points(), corners.T, middles):
        cells, local, inside = grid.locate(points)
        assert inside.all()
        again = grid.mesh.mapping().F(local[:, :, None], tind=cells)[:, :, 0].T
        np.testing.assert_allclose(again, points, atol=1e-15)
    assert not grid.locate(np.vstack([LOW - 1e-6, HIGH + 1e-6]))[2].any()


@pytest.mark.parametrize("lean", LEANS)
@pytest.mark.parametrize(("element", "order"), [("quad1", 1), ("quad2", 2)])
def test_sampling_reproduces_polynomials(block, element, order, lean):
    changes = {"tissue.mesh.element": element}
    model = TissueModel(block(changes, *lean))
    points = random_points(300)
    nodes, values, inside = model.shape_functions(points)
    assert inside.all()
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-13)

    def field(x, y, z):
        linear = 0.3 - 2 * x + 5 * z + 3 * y
        if order == 1:
            return linear
        return linear + 40 * x * x - 30 * x * z + 70 * z * y + 10 * y * y

    found = (values * field(*model.coordinates)[nodes]).sum(axis=1)
    np.testing.assert_allclose(found, field(*points.T), atol=1e-14)


def test_the_path_stays_in_one_column(block):
    """The lines follow a path that leans in both directions."""
    scene = block(None, 0.2, -0.25)
    grid = build_mesh(scene)
    from needle_sim_ros.tissue.mesh import planned_path

    path = planned_path(scene)
    points = np.linspace(0, path.depth, 20)[:, None] * path.direction + [1e-4, 1e-4, 0]
    cells, local, inside = grid.locate(points)
    assert inside.all()
    column = (len(grid.lateral[0].at) - 1) * (len(grid.lateral[1].at) - 1)
    assert len(set(cells % column)) == 1
    np.testing.assert_allclose(local[:2], local[:2, :1] * np.ones(20), atol=1e-12)


@pytest.fixture(scope="module")
def whole(block):
    """Full matrices, nothing held, of sheared hexahedra."""
    from needle_sim_ros.tissue.elements import assemble, scalar_basis
    from needle_sim_ros.tissue.material import MaterialField

    def make(element):
        scene = block({"tissue.mesh.element": element}, 0.2, -0.25)
        basis = scalar_basis(build_mesh(scene).mesh, element)
        stiffness, mass = assemble(basis, element, MaterialField(scene))
        return basis, stiffness, mass

    return make


@pytest.mark.parametrize("element", ["quad1", "quad2"])
def test_rigid_motions_cost_nothing_and_the_weight_is_right(whole, element):
    basis, stiffness, mass = whole(element)
    x, y, z = basis.doflocs
    zero, one = np.zeros_like(x), np.ones_like(x)
    motions = [(one, zero, zero), (zero, one, zero), (zero, zero, one)]
    motions += [(-y, x, zero), (zero, -z, y), (z, zero, -x)]
    scale = abs(stiffness).max() * 0.06
    for motion in motions:
        assert np.abs(stiffness @ np.array(motion).T.ravel()).max() < 1e-11 * scale
    assert mass.sum() == pytest.approx(1000 * math.prod(SIZE), rel=1e-12)


@pytest.mark.parametrize("element", ["quad1", "quad2"])
def test_patch(whole, element):
    """A linear displacement: no force on any inner node, and the energy of its strain."""
    basis, stiffness, _ = whole(element)
    gradient = np.array([[0.3, -0.1, 0.4], [0.2, -0.5, 0.1], [-0.3, 0.6, 0.2]])
    field = (gradient @ basis.doflocs).T.ravel()
    force = (stiffness @ field).reshape(-1, 3)
    x = basis.doflocs.T
    inner = ((x > LOW + 1e-9) & (x < HIGH - 1e-9)).all(axis=1)
    assert inner.sum() > 50
    assert np.abs(force[inner]).max() < 1e-10 * np.abs(force).max()
    lame, shear = lame_parameters(15e3, 0.4, None)
    strain = 0.5 * (gradient + gradient.T)
    density = 2 * shear * (strain**2).sum() + lame * np.trace(strain) ** 2
    assert field @ (stiffness @ field) == pytest.approx(density * math.prod(SIZE), rel=1e-10)


def test_no_locking(block):
    """From nu = 0.45 to 0.4999 the answer to a lateral force changes as in the plane: by a few
    per cent, where trilinear hexahedra without a pressure of their own lose most of it."""
    answers = []
    for ratio in (0.45, 0.4999):
        model = TissueModel(block({"tissue.poisson_ratio": ratio}))
        load = model.sampling(np.array([[0.0, 0.0, -0.01]])).T @ np.array([1.0, 0.0, 0.0])
        answers.append(load @ Factor(model.stiffness, model.elimination_order).solve(load))
    assert 0.75 < answers[1] / answers[0] < 1.05


@pytest.mark.parametrize("element", ["quad1", "quad2"])
def test_elimination_order(block, element):
    """A permutation, and the solution does not depend on it."""
    model = TissueModel(block({"tissue.mesh.element": element, "tissue.mesh.spacing_across": 8e-3}))
    order = model.elimination_order
    np.testing.assert_array_equal(np.sort(order), np.arange(len(model.free)))
    right = np.random.default_rng(1).normal(size=(len(order), 2))
    np.testing.assert_allclose(
        Factor(model.stiffness, order).solve(right),
        Factor(model.stiffness).solve(right),
        atol=1e-9 * np.abs(right).max(),
    )


@pytest.mark.parametrize("element", ["quad1", "quad2"])
def test_a_slab_between_rollers_is_plane_strain(block, element):
    """A slab held on rollers in front and behind, loaded evenly through its thickness, moves
    as the 2D model does, node by node."""
    mesh = {
        "element": element,
        "uniform": True,
        "spacing_across": 0.01,
        "spacing_along": 0.01,
    }
    held = {"fixed": ["left", "right", "bottom"], "mesh": mesh, "poisson_ratio": 0.49}
    thick = 0.05
    slab = {f"tissue.{k}": v for k, v in held.items()} | {
        "tissue.rollers": ["front", "back"],
        "solver.track_spacing": 0.02,
    }
    solid = TissueModel(block(slab))
    plane = TissueModel(
        block(
            slab
            | {
                "dimension": 2,
                "tissue.size": [SIZE[0], SIZE[2]],
                "tissue.rollers": [],
                "tissue.thickness": thick,
            }
        )
    )
    # the consistent load of a line through the thickness: a Gauss rule on its points
    ends, weights = np.polynomial.legendre.leggauss(60)
    force = np.array([0.7, -1.0])
    place = np.array([0.004, -0.013])
    line = np.column_stack([np.full(60, place[0]), 0.5 * thick * ends, np.full(60, place[1])])
    load = solid.sampling(line).T @ np.outer(0.5 * weights, [force[0], 0.0, force[1]]).ravel()
    flat = plane.sampling(place[None]).T @ force
    u3 = Factor(solid.stiffness, solid.elimination_order).solve(load)
    u2 = Factor(plane.stiffness).solve(flat)
    points = np.random.default_rng(3).uniform(LOW, HIGH, (50, 3))
    found = (solid.sampling(points) @ u3).reshape(-1, 3)
    expected = (plane.sampling(points[:, [0, 2]]) @ u2).reshape(-1, 2)
    largest = np.abs(expected).max()
    # the line's load is summed by a rule that sees the elements' edges: 1e-3
    np.testing.assert_allclose(found[:, [0, 2]], expected, atol=2e-3 * largest)
    assert np.abs(found[:, 1]).max() < 2e-3 * largest


def test_rollers_hold_what_is_normal_to_them(block):
    model = TissueModel(block({"tissue.fixed": ["bottom"], "tissue.rollers": ["left", "back"]}))
    x, y, z = model.coordinates
    free = np.zeros(3 * model.nodes, dtype=bool)
    free[model.free] = True
    bottom = z == -0.04
    np.testing.assert_array_equal(free[0::3], ~(bottom | (x == -0.03)))
    np.testing.assert_array_equal(free[1::3], ~(bottom | (y == 0.025)))
    np.testing.assert_array_equal(free[2::3], ~bottom)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"tissue.mesh.element": "tri2"}, r"tissue\.mesh\.element"),
        ({"tissue.rollers": ["top"]}, r"tissue\.rollers"),
        ({"tissue.fixed": ["left"], "tissue.rollers": ["left"]}, r"tissue\.rollers"),
    ],
)
def test_what_3d_does_not_take_is_refused(block, changes, key):
    with pytest.raises(SceneError, match=key):
        block(changes)


def test_lines_stand_on_the_faces_of_regions(block):
    box = {"name": "box", "shape": "box", "center": [0.003, -0.002, -0.02], "youngs_modulus": 5e4}
    box["size"] = [0.011, 0.013, 0.007]
    layer = {"name": "layer", "shape": "half_space", "center": [0, 0, -0.031], "density": 900.0}
    grid = build_mesh(block({"tissue.regions": [box, layer]}))
    for lines, faces in (
        (grid.lateral[0].at, (-0.0025, 0.0085)),
        (grid.lateral[1].at, (-0.0085, 0.0045)),
        (grid.levels, (-0.0235, -0.0165, -0.031)),
    ):
        assert (np.diff(lines) > 0).all()
        for face in faces:
            assert np.abs(lines - face).min() < 1e-12


def test_fitted_lines():
    """Near lines move, far ones are joined by another, ends and lines already used stay."""
    lines = np.array([0.0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(fitted(lines, [1.1]), [0, 1.1, 2, 3])
    np.testing.assert_allclose(fitted(lines, [1.4]), [0, 1, 1.4, 2, 3])
    np.testing.assert_allclose(fitted(lines, [1.0, 1.1]), [0, 1, 1.1, 2, 3])
    np.testing.assert_allclose(fitted(lines, [-1.0, 0.0, 3.0, 4.0]), lines)


def test_regions_change_the_mass_exactly(block):
    """With lines on its faces a box weighs what it should."""
    box = {"name": "box", "shape": "box", "center": [0.003, -0.002, -0.02], "density": 3000.0}
    box["size"] = [0.011, 0.013, 0.007]
    from needle_sim_ros.tissue.elements import assemble, scalar_basis
    from needle_sim_ros.tissue.material import MaterialField

    scene = block({"tissue.regions": [box]})
    basis = scalar_basis(build_mesh(scene).mesh, "quad1")
    _, mass = assemble(basis, "quad1", MaterialField(scene))
    assert sp.issparse(mass)
    expected = 1000 * math.prod(SIZE) + 2000 * 0.011 * 0.013 * 0.007
    assert mass.sum() == pytest.approx(expected, rel=1e-12)
