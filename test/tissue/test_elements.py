# SPDX-License-Identifier: Apache-2.0
"""Stiffness and mass: patch test, rigid bodies, exact bars, no locking, another assembler."""

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay
from skfem.models.elasticity import lame_parameters as skfem_lame
from skfem.models.elasticity import linear_elasticity

from needle_sim_ros.tissue.elements import Material, assemble, scalar_basis
from needle_sim_ros.tissue.material import lame_parameters

ELEMENTS = ["quad2", "quad1", "tri2", "tri1"]


def homogeneous(modulus, ratio, plane="strain", density=1000.0):
    lame, shear = lame_parameters(modulus, ratio, plane)

    def material(points):
        one = np.ones(points.shape[1:])
        return Material(lame * one, shear * one, density * one)

    return material


def block(element, columns=4, rows=3, width=2.0, height=1.0, distort=None):
    lines = np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1)
    kind = skfem.MeshQuad if element.startswith("quad") else skfem.MeshTri
    mesh = kind.init_tensor(*lines)
    return mesh if distort is None else type(mesh)(distort(mesh.p), mesh.t)


def sheared(p):
    return np.array([p[0] + 0.4 * p[1], p[1]])


def bent(p):
    """Move the inner lines so that no cell is a parallelogram; the outline stays straight."""
    x, y = p
    inner = np.sin(np.pi * x / 2) * np.sin(np.pi * y)
    return np.array([x + 0.4 * y + 0.11 * inner, y - 0.09 * inner])


def unknowns(nodes):
    return (2 * np.asarray(nodes)[:, None] + np.arange(2)).ravel()


def solve(stiffness, load, held, values):
    """Solve K u = f with the unknowns `held` at `values`."""
    u = np.zeros(stiffness.shape[0])
    u[held] = values
    free = np.setdiff1d(np.arange(len(u)), held)
    inner = sp.csc_matrix(stiffness[free][:, free])
    u[free] = spsolve(inner, (load - stiffness @ u)[free])
    return u


@pytest.mark.parametrize("distort", [sheared, bent])
@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.4999])
@pytest.mark.parametrize("element", ELEMENTS)
def test_patch(element, ratio, distort):
    """A linear displacement on the boundary gives that displacement inside."""
    basis = scalar_basis(block(element, distort=distort), element)
    stiffness, _ = assemble(basis, element, homogeneous(15e3, ratio))
    x, y = basis.doflocs
    exact = np.array([0.1 + 0.02 * x - 0.03 * y, -0.2 + 0.01 * x + 0.04 * y]).T.ravel()
    held = unknowns(basis.get_dofs().all())
    found = solve(stiffness, np.zeros(len(exact)), held, exact[held])
    np.testing.assert_allclose(found, exact, atol=1e-9)


@pytest.mark.parametrize("element", ELEMENTS)
def test_only_rigid_bodies_cost_nothing(element):
    """Unconstrained: exactly the two translations and the rotation, no hourglass modes."""
    basis = scalar_basis(block(element, 2, 2, distort=sheared), element)
    stiffness, _ = assemble(basis, element, homogeneous(15e3, 0.49))
    dense = stiffness.toarray()
    np.testing.assert_allclose(dense, dense.T, atol=1e-12 * np.abs(dense).max())
    values = np.linalg.eigvalsh(dense)
    assert np.abs(values[:3]).max() < 1e-12 * values[-1]
    assert values[3] > 1e-5 * values[-1]
    x, y = basis.doflocs
    turn = np.array([-y, x]).T.ravel()
    assert np.abs(dense @ turn).max() < 1e-12 * values[-1]


@pytest.mark.parametrize(("plane", "ratio"), [("stress", 0.3), ("strain", 0.3), ("strain", 0.49)])
@pytest.mark.parametrize("element", ELEMENTS)
def test_bar_under_tension(element, plane, ratio):
    """Uniaxial stress S along x: plane stress eps = S/E, -nu S/E; strain with E/(1-nu^2) etc."""
    modulus, stress = 15e3, 60.0
    basis = scalar_basis(block(element), element)
    stiffness, _ = assemble(basis, element, homogeneous(modulus, ratio, plane))
    pull = skfem.LinearForm(lambda v, w: stress * v).assemble(
        basis.boundary(basis.mesh.facets_satisfying(lambda p: np.isclose(p[0], 2)))
    )
    load = np.zeros(stiffness.shape[0])
    load[0::2] = pull
    x, y = basis.doflocs
    origin = np.flatnonzero((x == 0) & (y == 0))
    held = np.union1d(2 * np.flatnonzero(x == 0), 2 * origin + 1)
    u = solve(stiffness, load, held, 0.0)
    if plane == "stress":
        along, across = stress / modulus, -ratio * stress / modulus
    else:
        along = (1 - ratio**2) * stress / modulus
        across = -ratio * (1 + ratio) * stress / modulus
    np.testing.assert_allclose(u[0::2], along * x, atol=1e-10 * abs(along))
    np.testing.assert_allclose(u[1::2], across * y, atol=1e-10 * abs(along))


@pytest.mark.parametrize("element", ELEMENTS)
def test_mass(element):
    """rho A, and rho int x^2 = rho h w^3 / 3, of which linear shapes see the sampled field."""
    basis = scalar_basis(block(element), element)
    _, mass = assemble(basis, element, homogeneous(15e3, 0.3, density=800.0))
    assert mass.sum() == pytest.approx(800.0 * 2.0, rel=1e-12)
    x = basis.doflocs[0]
    if element != "tri1":  # one quadrature point is too few for the square of a linear field
        assert x @ (mass @ x) == pytest.approx(800.0 * 8 / 3, rel=1e-12)
    # of triangles the quadrature leaves it semidefinite, to rounding
    least = np.linalg.eigvalsh(mass.toarray())[0]
    assert least > (-1e-12 * mass.sum() if element.startswith("tri") else 0)


def unstructured(seed=3, count=60):
    rng = np.random.default_rng(seed)
    edge = np.linspace(0, 1, 7)
    border = [(x, y) for x in edge for y in edge if x in (0, 1) or y in (0, 1)]
    points = np.vstack([border, rng.uniform(0.08, 0.92, (count, 2))])
    return skfem.MeshTri(points.T, Delaunay(points).simplices.T)


def in_interleaved_order(basis, vector_basis):
    """For each of our unknowns 2 node + component, scikit-fem's."""
    names = np.array([0, 1])
    order = np.empty(2 * basis.N, dtype=int)
    for node in range(basis.N):
        place = basis.doflocs[:, node]
        there = np.flatnonzero(np.abs(vector_basis.doflocs - place[:, None]).max(axis=0) < 1e-12)
        order[2 * node + names] = np.sort(there)
    return order


@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.49])
def test_linear_triangles_are_scikit_fems_own(ratio):
    """Entry by entry scikit-fem's model of linear elasticity, on an unstructured mesh."""
    mesh = unstructured()
    basis = scalar_basis(mesh, "tri1")
    stiffness, _ = assemble(basis, "tri1", homogeneous(15e3, ratio))
    vector = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP1()))
    theirs = linear_elasticity(*skfem_lame(15e3, ratio)).assemble(vector).toarray()
    order = in_interleaved_order(basis, vector)
    np.testing.assert_allclose(
        stiffness.toarray(), theirs[np.ix_(order, order)], atol=1e-12 * np.abs(theirs).max()
    )


@pytest.mark.parametrize(
    ("element", "shape"),
    [
        ("quad2", skfem.ElementQuad2),
        ("quad1", skfem.ElementQuad1),
        ("tri2", skfem.ElementTriP2),
    ],
)
def test_without_a_volume_change_to_project_they_are_scikit_fems_own(element, shape):
    """At nu = 0 lambda is 0, nothing is projected, and K is plain full integration."""
    mesh = block(element, distort=bent)
    basis = scalar_basis(mesh, element)
    stiffness, _ = assemble(basis, element, homogeneous(15e3, 0.0))
    vector = skfem.Basis(mesh, skfem.ElementVector(shape()), quadrature=basis.quadrature)
    theirs = linear_elasticity(*skfem_lame(15e3, 0.0)).assemble(vector).toarray()
    order = in_interleaved_order(basis, vector)
    np.testing.assert_allclose(
        stiffness.toarray(), theirs[np.ix_(order, order)], atol=1e-9 * np.abs(theirs).max()
    )


def indentation(element, ratio, cells):
    """Push the middle of a block's top down by a smooth pressure; return how far it goes."""
    mesh = block(element, 2 * cells, cells)
    basis = scalar_basis(mesh, element)
    stiffness, _ = assemble(basis, element, homogeneous(15e3, ratio))
    top = mesh.facets_satisfying(lambda p: np.isclose(p[1], 1))
    pressure = skfem.LinearForm(lambda v, w: -np.exp(-(((w.x[0] - 1) / 0.3) ** 2)) * v)
    load = np.zeros(stiffness.shape[0])
    load[1::2] = pressure.assemble(basis.boundary(top))
    floor = np.flatnonzero((basis.doflocs[1] == 0) | np.isin(basis.doflocs[0], [0, 2]))
    return load @ solve(stiffness, load, unknowns(floor), 0.0)


@pytest.mark.parametrize(("element", "error"), [("quad2", 0.002), ("quad1", 0.03), ("tri2", 0.02)])
def test_no_locking(element, error):
    """At nu 0.4999 a coarse mesh gives nearly the work of a fine one, as at nu 0.3."""
    for ratio in (0.3, 0.4999):
        fine = indentation("quad2", ratio, 24)
        assert indentation(element, ratio, 8) == pytest.approx(fine, rel=error)


def test_linear_triangles_lock():
    """The elements of the paper: at nu 0.4999 they give a fraction of the displacement."""
    assert indentation("tri1", 0.3, 8) > 0.9 * indentation("quad2", 0.3, 24)
    assert indentation("tri1", 0.4999, 8) < 0.1 * indentation("quad2", 0.4999, 24)
