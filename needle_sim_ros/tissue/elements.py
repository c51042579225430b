# SPDX-License-Identifier: Apache-2.0
"""Stiffness and mass of the tissue (Eqs. 1 and 5) on elements that do not lock.

The strain energy is split into mu eps:eps and lambda/2 (div u)^2, and the divergence is
projected element by element on discontinuous pressures: linear ones for biquadratic
and triquadratic elements (the stable Q2/P1 pair), constant ones for bilinear and
trilinear elements (Q1/P0) and quadratic triangles. Linear triangles are left as they are:
they lock, as the paper's do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector

_CHUNK = {2: 20_000, 3: 1_000}
_ELEMENTS = {
    ("quad2", 2): skfem.ElementQuad2,
    ("quad1", 2): skfem.ElementQuad1,
    ("tri2", 2): skfem.ElementTriP2,
    ("tri1", 2): skfem.ElementTriP1,
    ("quad2", 3): skfem.ElementHex2,
    ("quad1", 3): skfem.ElementHex1,
    ("tri2", 3): skfem.ElementTetP2,
    ("tri1", 3): skfem.ElementTetP1,
}
_PRESSURE = {"quad2": "linear", "quad1": "constant", "tri2": "constant", "tri1": "none"}
_QUADRATURE = {"quad2": 4, "quad1": 2, "tri2": 2, "tri1": 1}


@dataclass(frozen=True)
class Material:
    """Lame parameters (Pa) and density (kg/m^3) at points, arrays of one shape."""

    lame: Vector
    shear: Vector
    density: Vector


def scalar_basis(mesh: skfem.Mesh, element: str) -> skfem.Basis:
    """Return the scalar basis; component c of node i is the unknown d i + c."""
    shape = _ELEMENTS[element, mesh.dim()]()
    # on four points the mass of a quadratic tetrahedron would have no inverse
    order = 4 if (element, mesh.dim()) == ("tri2", 3) else _QUADRATURE[element]
    return skfem.Basis(mesh, shape, intorder=order)


def assemble(
    basis: skfem.Basis, element: str, material: Callable[[Vector], Material]
) -> tuple[sp.csr_array, sp.csr_array]:
    """Assemble the stiffness and the mass matrix of the tissue.

    Parameters
    ----------
    basis : skfem.Basis
        From :func:`scalar_basis`, n nodes in d dimensions.
    element : str
        The kind of element, which sets the pressure space.
    material : callable
        Maps points, shape (d, cells, quadrature points), to their :class:`Material`.

    Returns
    -------
    stiffness : csr_array, shape (d n, d n)
        Per metre of thickness in 2D (N/m^2), N/m in 3D.
    mass : csr_array, shape (n, n)
        The same for each component, kg/m in 2D, kg in 3D.
    """
    d, nodes = basis.mesh.dim(), basis.N
    dofs = np.asarray(basis.element_dofs, dtype=np.int32)
    gradient = np.array([f[0].grad for f in basis.basis])  # (b, d, cells, q)
    value = np.array([np.broadcast_to(f[0], basis.dx.shape) for f in basis.basis])
    where = np.asarray(basis.global_coordinates())
    at = material(where)
    stiffness, mass = _Sum(d * nodes), _Sum(nodes)
    for start in range(0, dofs.shape[1], _CHUNK[d]):
        part = slice(start, start + _CHUNK[d])
        cut = Material(at.lame[part], at.shear[part], at.density[part])
        block = _stiffness(gradient[:, :, part], basis.dx[part], where[:, part], cut, element)
        here = dofs[:, part]
        wide = (d * here[:, None, :] + np.arange(d)[None, :, None]).reshape(-1, here.shape[1])
        stiffness.add(_scatter(block, wide, d * nodes))
        small = np.einsum(
            "ieq,jeq,eq->eij",
            value[:, part],
            value[:, part],
            cut.density * basis.dx[part],
            optimize=True,
        )
        mass.add(_scatter(small, here, nodes))
    return stiffness.total(), mass.total()


def _stiffness(gradient: Vector, dx: Vector, where: Vector, at: Material, element: str) -> Vector:
    b, d, cells, _ = gradient.shape
    g = np.moveaxis(gradient, 2, 0)  # (cells, b, d, q)
    weighted = g * (at.shear * dx)[:, None, None, :]
    # int mu (delta_ac grad_i . grad_j + d_c phi_i d_a phi_j), components a, c of nodes i, j
    cross = np.einsum("eicq,ejaq->eiajc", weighted, g, optimize=True)
    block = cross.copy()
    trace = np.einsum("eicjc->eij", cross)
    for a in range(d):
        block[:, :, a, :, a] += trace
    block = block.reshape(cells, b * d, b * d)
    kind = _PRESSURE[element]
    if kind == "none":
        divergence = g.reshape(cells, b * d, -1)
        return np.asarray(
            block + (divergence * (at.lame * dx)[:, None, :]) @ divergence.transpose(0, 2, 1)
        )
    pressure = _pressures(where, dx, kind)  # (p, cells, q)
    moment = np.einsum("peq,eiaq,eq->epia", pressure, g, dx, optimize=True)
    moment = moment.reshape(cells, len(pressure), b * d)
    # a Lame parameter of nothing (nu = 0) must not divide
    softness = dx / np.maximum(at.lame, 1e-12 * at.shear)
    gram = np.einsum("peq,req,eq->epr", pressure, pressure, softness, optimize=True)
    return np.asarray(block + moment.transpose(0, 2, 1) @ np.linalg.solve(gram, moment))


def _pressures(where: Vector, dx: Vector, kind: str) -> Vector:
    one = np.ones_like(dx)
    if kind == "constant":
        return one[None]
    volume = dx.sum(axis=1, keepdims=True)
    linear = []
    for x in where:
        offset = x - (x * dx).sum(axis=1, keepdims=True) / volume
        linear.append(offset / np.sqrt((offset**2 * dx).sum(axis=1, keepdims=True) / volume))
    return np.array([one, *linear])


class _Sum:
    """Adds sparse matrices in pairs of like size: each entry is copied few times."""

    def __init__(self, size: int) -> None:
        self._parts: list[tuple[int, sp.csr_array]] = [(0, sp.csr_array((size, size)))]

    def add(self, matrix: sp.csr_array) -> None:
        """Add a matrix."""
        count = 1
        while self._parts and self._parts[-1][0] <= count:
            more, other = self._parts.pop()
            matrix, count = other + matrix, count + more
        self._parts.append((count, matrix))

    def total(self) -> sp.csr_array:
        """Return the sum of all that was added."""
        total = self._parts.pop()[1]
        while self._parts:
            total = self._parts.pop()[1] + total
        return total


def _scatter(blocks: Vector, dofs: NDArray[np.int32], size: int) -> sp.csr_array:
    count = dofs.shape[0]
    rows = np.repeat(dofs.T[:, :, None], count, axis=2).ravel()
    columns = np.repeat(dofs.T[:, None, :], count, axis=1).ravel()
    return sp.csr_array(sp.coo_array((blocks.ravel(), (rows, columns)), shape=(size, size)))
