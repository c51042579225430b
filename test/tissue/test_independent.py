# SPDX-License-Identifier: Apache-2.0
"""The tissue under a needle's forces, computed once more by scikit-fem alone.

Quadratic triangles on an unstructured mesh, scikit-fem's own model of linear elasticity,
its own quadrature and point search. The forces of an insertion are spread over the
needle's width and the hats of the track as the design says.
"""

import numpy as np
import pytest
import scipy.sparse as sp
import skfem
from scipy.spatial import Delaunay
from skfem.models.elasticity import lame_parameters, linear_elasticity

from needle_sim_ros import Simulator

RADIUS, SPACING, THICKNESS = 1e-3, 1e-3, 0.024
DETAILED = {
    "needle.tip.deviation_angle": 0.0,
    "tissue.size": [0.06, 0.04],
    "tissue.mesh.spacing_across": 0.5e-3,
    "tissue.mesh.spacing_along": 1e-3,
    "solver.track_spacing": SPACING,
    "protocol": [{"duration": 9.0, "velocity": [0.0, 0.0, -3e-3]}],
}


def unstructured():
    """Points dense about the track, thrown off their lines at random, triangulated."""
    rng = np.random.default_rng(7)
    grown = np.cumsum(np.minimum(0.5e-3 * 1.2 ** np.arange(1, 30), 1.8e-3))
    x = 3e-3 + grown[grown < 0.026]
    x = np.concatenate([-0.03 * np.ones(1), -x[::-1], np.linspace(-3e-3, 3e-3, 13), x, [0.03]])
    z = -0.018 - grown[grown < 0.021]
    z = np.concatenate([[-0.04], z[::-1], np.linspace(-0.018, 0, 37)])
    throw = [0.25 * np.minimum(np.diff(v, prepend=-1), np.diff(v, append=1)) for v in (x, z)]
    for size in throw:
        size[[0, -1]] = 0.0  # the outline stays
    place, by = np.meshgrid(x, z), np.meshgrid(*throw)
    points = np.array([p + t * rng.uniform(-1, 1, p.shape) for p, t in zip(place, by, strict=True)])
    points = points.reshape(2, -1)
    triangles = Delaunay(points.T).simplices
    sides = points.T[triangles[:, 1:]] - points.T[triangles[:, :1]]
    flat = np.abs(np.linalg.det(sides)) < 1e-14
    return skfem.MeshTri(points, triangles[~flat].T)


class Independent:
    """scikit-fem's tissue: held at left, right and bottom."""

    def __init__(self):
        self.scalar = skfem.Basis(unstructured(), skfem.ElementTriP2(), intorder=4)
        basis = skfem.Basis(self.scalar.mesh, skfem.ElementVector(skfem.ElementTriP2()), intorder=4)
        stiffness = THICKNESS * linear_elasticity(*lame_parameters(15e3, 0.49)).assemble(basis)
        x, z = basis.doflocs
        held = np.flatnonzero((np.abs(np.abs(x) - 0.03) < 1e-9) | (np.abs(z + 0.04) < 1e-9))
        self.free = np.setdiff1d(np.arange(basis.N), held)
        self.basis = basis
        self.solve = sp.linalg.factorized(sp.csc_matrix(stiffness)[self.free][:, self.free])

    def sample(self, points):
        """Matrix that samples (x, z) at points (n, 2): rows x of all, then z of all."""
        return self.basis.probes(np.asarray(points).T)

    def mean(self, k):
        """Places and weights of track point k: its hat times the needle's width."""
        across, share = np.polynomial.legendre.leggauss(6)
        along, part = np.polynomial.legendre.leggauss(4)
        if k == 0:
            places = [(RADIUS * a, -1e-9) for a in across]
            return places, share / 2
        depths = np.concatenate([(k - 0.5 + 0.5 * along), (k + 0.5 + 0.5 * along)]) * SPACING
        hats = np.concatenate([0.5 * (1 + along), 0.5 * (1 - along)]) * np.tile(part, 2) / 2
        places = [(RADIUS * a, -d) for d in depths for a in across]
        return places, np.outer(hats, share / 2).ravel()


@pytest.fixture(scope="module")
def inserted(coarse_scene, drive):
    """12 mm deep, then the base 1.5 mm aside: forces in both directions."""
    sim = Simulator(coarse_scene(DETAILED))
    drive(sim, 22.0 / 3, (0, 0, -3e-3), dt=22.0 / 300)
    o = drive(sim, 1.0, (1.5e-3, 0, 0), dt=0.1)[-1]
    forces, points = o._contact.forces, o._contact.track.points
    np.testing.assert_allclose(points[:, 0], 0.0, atol=1e-12)  # a straight track
    np.testing.assert_allclose(-points[:, 1], SPACING * np.arange(len(points)), atol=1e-12)
    np.testing.assert_allclose(forces.sum(axis=0), o.contact_forces.sum(axis=0)[[0, 2]], rtol=1e-9)
    return sim, o, forces


@pytest.fixture(scope="module")
def again(inserted):
    """The same forces on the other mesh: (tissue, displacements of its unknowns)."""
    _, _, forces = inserted
    other = Independent()
    load = np.zeros(other.basis.N)
    for k, force in enumerate(forces):
        places, weights = other.mean(k)
        matrix, count = other.sample(places), len(weights)
        load += matrix.T @ np.concatenate([force[0] * weights, force[1] * weights])
        assert matrix.shape[0] == 2 * count
    u = np.zeros(other.basis.N)
    u[other.free] = other.solve(load[other.free])
    return other, u


def compared(inserted, again, places):
    sim, _, _ = inserted
    other, u = again
    mine = sim.tissue_displacement(np.column_stack([places[:, 0], 0 * places[:, 0], places[:, 1]]))
    theirs = (other.sample(places) @ u).reshape(2, -1).T
    return mine[:, [0, 2]], theirs


def test_outside_the_track_s_neighbourhood(inserted, again):
    """More than 4 mm away: within 1 % of the largest displacement there, nearly all 0.3 %."""
    places = np.random.default_rng(1).uniform([-0.029, -0.039], [0.029, -0.0005], (400, 2))
    away = np.hypot(places[:, 0], np.minimum(places[:, 1] + 0.014, 0)) > 4e-3
    mine, theirs = compared(inserted, again, places[away])
    miss = np.abs(mine - theirs) / np.abs(theirs).max()
    assert miss.max() < 0.01
    assert np.quantile(miss, 0.98) < 3e-3


def test_inside_the_track_s_neighbourhood(inserted, again):
    """Within 2 mm of the needle's axis, from the surface to beyond its tip: within 1 %."""
    places = np.random.default_rng(2).uniform([-2e-3, -0.016], [2e-3, -0.0005], (200, 2))
    mine, theirs = compared(inserted, again, places)
    assert np.abs(theirs).max() > 5e-4
    np.testing.assert_allclose(mine, theirs, atol=0.01 * np.abs(theirs).max())


def test_the_needle_fits_the_other_tissue(inserted, again):
    """There too the track points lie on the bent needle (more than a bevel behind its tip)
    and the tissue's response to the needle's forces does the same work."""
    sim, o, forces = inserted
    other, u = again
    moved = []
    for k in range(len(forces)):
        places, weights = other.mean(k)
        moved.append((other.sample(places) @ u).reshape(2, -1) @ weights)
    moved = np.array(moved)
    s = o._contact.arclength
    behind = s < 0.13 - 5.5e-3
    held = int(behind.sum())
    assert held >= 5
    needle = o.base_position[0] + o._bent(s)[0]
    np.testing.assert_allclose(moved[:held, 0], needle[:held], atol=0.005 * np.abs(needle).max())
    rows = sim.tissue_displacement([[0, 0, -5e-3]])  # the field is there
    assert np.isfinite(rows).all()
    table = o._contact.track.table
    own = (table.between() @ forces.ravel()).reshape(-1, 2)
    assert (own * forces).sum() == pytest.approx((moved * forces).sum(), rel=5e-3)
