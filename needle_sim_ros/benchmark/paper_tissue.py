# SPDX-License-Identifier: Apache-2.0
"""The paper's tissue, Eqs. (1) to (5): linear triangles and Newmark's method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.sparse.linalg import splu
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

from needle_sim_ros.benchmark.paper_mesh import Crossing, UniformMesh
from needle_sim_ros.errors import SceneError
from needle_sim_ros.scene import Scene

Array = NDArray[np.float64]
Matrix = Any  # scipy's sparse arrays are generic only in their stubs

# The fastest of SuperLU's orderings on this matrix, by measurement.
_ORDERING: Final = "MMD_AT_PLUS_A"


class Coupling:
    """Needle nodes and the tissue nodes S around them, Eqs. (18) to (21).

    Parameters
    ----------
    nodes : sequence of n Crossing

    Attributes
    ----------
    near : ndarray, shape (m,)
        The tissue nodes S.
    to_needle : ndarray, shape (n, m)
        K_StoP of Eq. (19). Its transpose is K_PtoS of Eq. (21), which keeps the sum of the
        forces because the rows here add up to 1.
    """

    def __init__(self, nodes: Sequence[Crossing]) -> None:
        ends = np.array([(node.first, node.second) for node in nodes])
        weight = np.array([node.weight for node in nodes])
        self.near, where = np.unique(ends, return_inverse=True)
        where = where.reshape(ends.shape)
        row = np.arange(len(nodes))
        self.to_needle = np.zeros((len(nodes), len(self.near)))
        self.to_needle[row, where[:, 0]] = 1 - weight
        self.to_needle[row, where[:, 1]] += weight


class PaperTissue:
    """Tissue on the unknowns that are not fixed: u_B = 0 is left out (Eq. 24).

    Eq. (4) prints C / (xi dt) on the left where its derivation gives delta C / (xi dt); the
    latter is used. As printed, a damped tissue would rest away from its equilibrium.

    Parameters
    ----------
    scene : Scene
        Two-dimensional, without regions. Quasi-static scenes leave the inertia out.
    nodes : int
        About how many tissue nodes.

    Attributes
    ----------
    stiffness, mass, damping, effective : csc_array, shape (unknowns, unknowns)
        K, M, C of Eq. (1) and the left side of Eq. (4).
    displacement, velocity, acceleration : ndarray, shape (unknowns,)

    Raises
    ------
    SceneError
        On 3D scenes and regions.
    """

    def __init__(self, scene: Scene, nodes: int) -> None:
        tissue, solver = scene.tissue, scene.solver
        if scene.dimension != 2:
            raise SceneError("dimension", scene.dimension, "the paper's algorithm is 2D")
        if tissue.regions:
            raise SceneError("tissue.regions", len(tissue.regions), "the paper's tissue has none")
        self.mesh = UniformMesh(tissue.size[0], tissue.size[1], nodes)
        mesh = skfem.MeshTri(self.mesh.points, self.mesh.triangles)
        basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTriP1()))
        free = np.ones(self.mesh.points.shape[1], dtype=bool)
        for face in tissue.fixed or ():
            free[self.mesh.face(face)] = False
        self._unknown = np.full((2, len(free)), -1)
        self._unknown[:, free] = np.arange(2 * free.sum()).reshape((2, -1), order="F")
        kept = basis.nodal_dofs[:, free].ravel(order="F")

        def on_unknowns(form: skfem.BilinearForm, scale: float) -> Matrix:
            return sparse.csc_array(scale * form.assemble(basis).tocsr()[kept][:, kept])

        first, second = lame_parameters(tissue.youngs_modulus, tissue.poisson_ratio)
        if tissue.plane == "stress":
            first = 2 * first * second / (first + 2 * second)
        inertia = skfem.BilinearForm(lambda u, v, w: dot(u, v))
        self.stiffness = on_unknowns(linear_elasticity(first, second), tissue.thickness)
        self.mass = on_unknowns(inertia, tissue.density * tissue.thickness)
        self.damping = tissue.damping.alpha * self.mass + tissue.damping.beta * self.stiffness
        self.dynamic = solver.dynamics == "newmark"
        self._step = solver.time_step
        self._delta, self._xi = solver.newmark.delta, solver.newmark.xi
        self.effective = self.stiffness
        if self.dynamic:
            self.effective = sparse.csc_array(
                self.stiffness
                + self.mass / (self._xi * self._step**2)
                + self.damping * (self._delta / (self._xi * self._step))
            )
        # Without a needle in it the matrix never changes: factorised once.
        self._alone = splu(self.effective, permc_spec=_ORDERING)
        self.rest()

    def rest(self) -> None:
        """Return to rest without displacement."""
        self.displacement, self.velocity, self.acceleration = np.zeros((3, self.stiffness.shape[0]))

    def history(self) -> Array:
        """Return the right side of Eq. (4) but for the load, N; zeros when quasi-static."""
        u, v, a = self.displacement, self.velocity, self.acceleration
        if not self.dynamic:
            return np.zeros_like(u)
        step, delta, xi = self._step, self._delta, self._xi
        inertial = u / (xi * step**2) + v / (xi * step) + (1 / (2 * xi) - 1) * a
        viscous = delta / (xi * step) * u + (delta / xi - 1) * v + (delta / (2 * xi) - 1) * step * a
        load: Array = self.mass @ inertial + self.damping @ viscous
        return load

    def accept(self, moved: Array) -> None:
        """Take the displacement of Eq. (4) and update velocity and acceleration, Eqs. (2), (3)."""
        if self.dynamic:
            step, delta, xi = self._step, self._delta, self._xi
            u, v, a = self.displacement, self.velocity, self.acceleration
            later = (moved - u - step * v) / (xi * step**2) - (0.5 - xi) / xi * a
            self.velocity = v + step * ((1 - delta) * a + delta * later)
            self.acceleration = later
        self.displacement = moved

    def solve(self, load: Array) -> Array:
        """Return the displacement under `load` without a needle, Eq. (5)."""
        moved: Array = self._alone.solve(load)
        return moved

    def solve_with(self, needle: Array, side: Array, coupling: Coupling, load: Array) -> Array:
        """Return the displacement with the needle's stiffness added, Eqs. (17), (22) to (24).

        Parameters
        ----------
        needle : ndarray, shape (n, n)
            The needle's K of Eq. (7), along `side`, N/m.
        side : ndarray, shape (2,)
            Deflection direction in x, z: R_e of Eq. (12) at work.
        coupling : Coupling
            Of the n needle nodes.
        load : ndarray, shape (unknowns,)
        """
        coupled = coupling.to_needle.T @ needle @ coupling.to_needle  # Eq. (22)
        sides = np.flatnonzero(np.abs(side) > 1e-12)
        block = np.kron(np.outer(side[sides], side[sides]), coupled)
        place = self._unknown[np.ix_(sides, coupling.near)].ravel()
        free = np.flatnonzero(place >= 0)
        place = place[free]
        where = np.repeat(place, len(place)), np.tile(place, len(place))
        extra = sparse.csc_array((block[np.ix_(free, free)].ravel(), where), self.stiffness.shape)
        whole = splu(self.effective + extra, permc_spec=_ORDERING)  # Eq. (17)
        moved: Array = whole.solve(load)  # Eq. (24)
        return moved

    def spread(self, coupling: Coupling, forces: ArrayLike) -> Array:
        """Return the load of forces (n, 2) at the needle nodes, Eqs. (20) and (21)."""
        # The place after the last unknown takes what falls on fixed nodes.
        load = np.zeros(self.stiffness.shape[0] + 1)
        load[self._unknown[:, coupling.near].T] = coupling.to_needle.T @ np.asarray(forces)
        return load[:-1]

    def at(self, coupling: Coupling, moved: Array) -> Array:
        """Return the displacement (n, 2) of the needle nodes, Eqs. (18) and (19)."""
        sampled: Array = coupling.to_needle @ self._read(coupling.near, moved).T
        return sampled

    def inside(self, points: ArrayLike, moved: Array) -> Array:
        """Return the displacement (n, 2) at material points (n, 2) by the shape functions."""
        corners, weights = self.mesh.locate(points)
        sampled: Array = np.einsum("cke,ke->kc", self._read(corners, moved), weights)
        return sampled

    def _read(self, nodes: NDArray[np.int64], moved: Array) -> Array:
        # Unknown -1, a fixed node, reads the zero at the end.
        values: Array = np.append(moved, 0.0)[self._unknown[:, nodes]]
        return values
