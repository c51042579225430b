# SPDX-License-Identifier: Apache-2.0
"""Displacements under the needle's spread forces against the solutions of Kelvin and Flamant.

A force on a chord of length L spreads as the uniform mean over it. Means of the logarithm:
over the chord, of the distance to a point on its line x away from its middle,
((x + L/2) ln(x + L/2) - (x - L/2) ln(x - L/2)) / L - 1; and over both ends, ln L - 3/2.
"""

import math

import numpy as np
import pytest
import scipy.sparse as sp
import skfem

from needle_sim_ros.interaction.coupling import Coupling
from needle_sim_ros.tissue.elements import Material, assemble, scalar_basis
from needle_sim_ros.tissue.factor import Factor
from needle_sim_ros.tissue.material import lame_parameters
from needle_sim_ros.tissue.mesh import graded
from needle_sim_ros.tissue.model import TissueModel

MODULUS, CHORD = 15e3, 2e-3
GAUSS, SHARE = np.polynomial.legendre.leggauss(16)


def mean_logarithm(x):
    """Mean of ln |x - s| over the chord |s| < L/2, for x beyond its end."""
    a, b = x + CHORD / 2, x - CHORD / 2
    return (a * math.log(a) - b * math.log(b)) / CHORD - 1


def kelvin(points, axis, ratio):
    """Displacements (2, n) in the infinite plane under a unit force along `axis`, spread over
    the chord on the x axis about the origin: the mean of Kelvin's solution (plane strain)."""
    shear = MODULUS / (2 * (1 + ratio))
    total = np.zeros((2, points.shape[1]))
    for s, weight in zip(GAUSS * CHORD / 2, SHARE / 2, strict=True):
        r = points - np.array([[s], [0.0]])
        distance2 = (r**2).sum(axis=0)
        u = r * r[axis] / distance2
        u[axis] -= (3 - 4 * ratio) * 0.5 * np.log(distance2)
        total += weight * u
    return total / (8 * math.pi * shear * (1 - ratio))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("ratio", [0.3, 0.49])
def test_kelvin(axis, ratio):
    """The exact displacement on the rim of a square of 40 mm, the force in its middle: at
    random points, and in the mean over the loaded chord itself, c ((3 - 4 nu) (3/2 - ln L)
    + [1 along the chord])."""
    lines = graded(-0.02, 0.02, (-2e-3, 2e-3), 0.25e-3, 1.3, 2e-3)
    mesh = skfem.MeshQuad.init_tensor(lines, lines)
    basis = scalar_basis(mesh, "quad2")
    lame, shear = lame_parameters(MODULUS, ratio, "strain")
    one = np.ones(basis.dx.shape)
    stiffness, _ = assemble(basis, "quad2", lambda _: Material(lame * one, shear * one, one))
    chord = np.array([GAUSS * CHORD / 2, np.full(16, 1e-12)])
    spread = basis.probes(chord).T @ (SHARE / 2)
    load, u = np.zeros(2 * basis.N), np.zeros(2 * basis.N)
    load[axis::2] = spread
    rim = basis.get_dofs().flatten()
    for a in (0, 1):
        u[2 * rim + a] = kelvin(basis.doflocs[:, rim], axis, ratio)[a]
    free = np.setdiff1d(np.arange(len(u)), np.concatenate([2 * rim, 2 * rim + 1]))
    inner = sp.csc_matrix(stiffness[free][:, free])
    u[free] = sp.linalg.spsolve(inner, (load - stiffness @ u)[free])

    places = np.random.default_rng(0).uniform(-0.015, 0.015, (2, 60))
    places = places[:, np.hypot(*places) > 2e-3]
    exact = kelvin(places, axis, ratio)
    found = np.array([basis.probes(places) @ u[a::2] for a in (0, 1)])
    np.testing.assert_allclose(found, exact, atol=2e-4 * np.ptp(exact))

    constant = 1 / (8 * math.pi * shear * (1 - ratio))
    mean = constant * ((3 - 4 * ratio) * (1.5 - math.log(CHORD)) + (axis == 0))
    level = kelvin(np.array([[0.015], [0.0]]), axis, ratio)[axis, 0]
    assert spread @ u[axis::2] - level == pytest.approx(mean - level, rel=2e-3)


@pytest.fixture(scope="module")
def half_plane(coarse_scene):
    """A block so large beside the needle, 2 m by 1 m, that it is a half plane near it."""

    def make(ratio):
        return TissueModel(
            coarse_scene({
                "tissue.size": [2.0, 1.0],
                "tissue.poisson_ratio": ratio,
                "tissue.thickness": 1.0,
                "tissue.mesh": {"spacing_across": 2.5e-4, "spacing_along": 2.5e-4,
                                "growth": 1.3, "largest": 0.1, "band": 2e-3},
                "solver.track_spacing": 1e-3,
                "protocol": [{"duration": 4.0, "velocity": [0, 0, -3e-3]}],
            })
        )  # fmt: skip

    return make


@pytest.mark.parametrize("ratio", [0.3, 0.49])
def test_flamant(half_plane, ratio):
    """The needle's cross-section pressed on the surface: how the surface sinks beside it,
    2 (1 - nu^2) / (pi E) times the difference of the mean logarithms, and under it."""
    model = half_plane(ratio)
    footprint = Coupling(model, CHORD / 2).section(np.zeros(2), np.array([0.0, -1.0]))
    load = np.zeros((model.nodes, 2))
    load[footprint.nodes, 1] = -footprint.weights
    u = np.zeros(2 * model.nodes)
    u[model.free] = Factor(model.stiffness).solve(load.ravel()[model.free])
    field = u.reshape(-1, 2)[:, 1]

    distances = np.array([3e-3, 6e-3, 12e-3, 24e-3])
    nodes, values, _ = model.shape_functions(np.column_stack([distances, np.zeros(4)]))
    sunk = -(values * field[nodes]).sum(axis=1)
    scale = 2 * (1 - ratio**2) / (math.pi * MODULUS)
    logarithms = np.array([mean_logarithm(x) for x in distances])
    np.testing.assert_allclose(sunk - sunk[-1], scale * (logarithms[-1] - logarithms), rtol=3e-3,
                               atol=1e-4 * scale)  # fmt: skip
    under = -float(footprint.weights @ field[footprint.nodes])
    own = scale * (logarithms[-1] - (math.log(CHORD) - 1.5))
    assert under - sunk[-1] == pytest.approx(own, rel=3e-3)


def test_a_point_force_has_no_limit_and_a_spread_one_has():
    """The displacement under a force on one node grows by ln 2 (3 - 4 nu) c at each halving
    of the mesh (Kelvin's logarithm); that of the spread force settles."""
    ratio = 0.3
    lame, shear = lame_parameters(MODULUS, ratio, "strain")
    own = {"node": [], "chord": []}
    for cells in (12, 24, 48):
        lines = np.linspace(-6e-3, 6e-3, cells + 1)
        basis = scalar_basis(skfem.MeshQuad.init_tensor(lines, lines), "quad2")
        one = np.ones(basis.dx.shape)
        stiffness, _ = assemble(
            basis, "quad2", lambda _, one=one: Material(lame * one, shear * one, one)
        )
        rim = basis.get_dofs().flatten()
        free = np.setdiff1d(np.arange(2 * basis.N), np.concatenate([2 * rim, 2 * rim + 1]))
        factor = Factor(sp.csr_array(stiffness[free][:, free]))
        for name, x in (("node", np.zeros(1)), ("chord", GAUSS * CHORD / 2)):
            weights = np.ones(1) if name == "node" else SHARE / 2
            places = np.array([x, np.full(len(x), 1e-12)])
            load = np.zeros(2 * basis.N)
            load[1::2] = basis.probes(places).T @ weights
            own[name].append(load[free] @ factor.solve(load[free]))
    steps = np.diff(own["node"])
    constant = (3 - 4 * ratio) / (8 * math.pi * shear * (1 - ratio))
    np.testing.assert_allclose(steps, constant * math.log(2), rtol=0.02)
    settled = np.diff(own["chord"])
    assert abs(settled[1]) < 0.03 * steps[1]
