# SPDX-License-Identifier: Apache-2.0
"""Observed orders of convergence under refinement, for displacements made up beforehand.

-mu lap u - (lambda + mu) grad div u = f on the sheared unit square, u given on its boundary.

- compressible: u = (sin(pi x) sin(pi y), 0), so with S = sin sin and C = cos cos
  f = pi^2 ((3 mu + lambda) S, -(lambda + mu) C);
- incompressible: u = curl of sin(pi x) sin(pi y), so div u = 0 and f = 2 pi^2 mu u
  whatever lambda is: the order may not suffer as nu goes to 0.5.
"""

import math

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import spsolve

from needle_sim_ros.tissue.elements import Material, assemble, scalar_basis
from needle_sim_ros.tissue.material import lame_parameters


def compressible(x, y, lame, shear):
    s, c = np.sin(np.pi * x) * np.sin(np.pi * y), np.cos(np.pi * x) * np.cos(np.pi * y)
    exact = np.array([s, 0 * s])
    return exact, np.pi**2 * np.array([(3 * shear + lame) * s, -(lame + shear) * c])


def incompressible(x, y, lame, shear):
    exact = np.pi * np.array(
        [np.sin(np.pi * x) * np.cos(np.pi * y), -np.cos(np.pi * x) * np.sin(np.pi * y)]
    )
    return exact, 2 * np.pi**2 * shear * exact


def error(element, ratio, solution, cells):
    """Return the L2 error of the displacement."""
    lame, shear = lame_parameters(15e3, ratio, "strain")
    kind = skfem.MeshQuad if element.startswith("quad") else skfem.MeshTri
    mesh = kind.init_tensor(*(np.linspace(0, 1, cells + 1),) * 2)
    mesh = kind(np.array([mesh.p[0] + 0.3 * mesh.p[1], mesh.p[1]]), mesh.t)
    basis = scalar_basis(mesh, element)
    one = np.ones(basis.dx.shape)
    stiffness, _ = assemble(basis, element, lambda _: Material(lame * one, shear * one, one))
    exactly = skfem.Basis(mesh, basis.elem, intorder=6)
    load, u = np.zeros(2 * basis.N), np.zeros(2 * basis.N)
    for axis in (0, 1):
        form = skfem.LinearForm(lambda v, w, a=axis: solution(*w.x, lame, shear)[1][a] * v)
        load[axis::2] = form.assemble(exactly)
        u[axis::2] = solution(*basis.doflocs, lame, shear)[0][axis]
    edge = basis.get_dofs().all()
    free = np.setdiff1d(np.arange(len(u)), np.concatenate([2 * edge, 2 * edge + 1]))
    u[free] = 0.0
    u[free] = spsolve(sp.csc_matrix(stiffness[free][:, free]), (load - stiffness @ u)[free])
    total = 0.0
    for axis in (0, 1):
        miss = skfem.Functional(lambda w, a=axis: (w["u"] - solution(*w.x, lame, shear)[0][a]) ** 2)
        total += miss.assemble(exactly, u=exactly.interpolate(u[axis::2]))
    return math.sqrt(total)


@pytest.mark.parametrize(
    ("element", "solution", "ratio", "order"),
    [
        ("quad2", compressible, 0.3, 2.8),
        ("quad2", incompressible, 0.49, 2.8),
        ("quad2", incompressible, 0.4999, 2.8),
        ("quad1", compressible, 0.3, 1.9),
        ("quad1", incompressible, 0.4999, 1.9),
        ("tri2", compressible, 0.3, 1.9),
        ("tri2", incompressible, 0.4999, 1.9),
        ("tri1", compressible, 0.3, 1.8),
    ],
)
def test_order(element, solution, ratio, order):
    coarse, fine = (error(element, ratio, solution, cells) for cells in (10, 20))
    assert math.log2(coarse / fine) >= order


def test_linear_triangles_stop_converging_near_incompressibility():
    """Halving the cells of the paper's elements gains little at nu 0.4999: they lock."""
    coarse, fine = (error("tri1", 0.4999, incompressible, cells) for cells in (10, 20))
    assert math.log2(coarse / fine) < 0.5
    assert fine > 100 * error("quad2", 0.4999, incompressible, 20)
