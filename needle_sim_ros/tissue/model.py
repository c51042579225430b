# SPDX-License-Identifier: Apache-2.0
"""The tissue of a scene, assembled: K and M on the free unknowns (Eq. 5), sampling of points."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from needle_sim_ros.errors import SceneError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue import compiled_grid
from needle_sim_ros.tissue.elements import assemble, scalar_basis
from needle_sim_ros.tissue.grid_order import nested_dissection
from needle_sim_ros.tissue.material import MaterialField
from needle_sim_ros.tissue.mesh import Index, TissueMesh, build_mesh
from needle_sim_ros.tissue.mesh_file import read_tetrahedra
from needle_sim_ros.tissue.ordering import unknowns_order
from needle_sim_ros.tissue.tetrahedra import Tetrahedra


class TissueModel:
    """Mesh, stiffness and mass of a scene's tissue.

    Attributes
    ----------
    dimension : int
        d, 2 or 3.
    nodes : int
        Number of nodes n; component c of node i is the unknown d i + c.
    free : ndarray of int
        Unknowns that are not fixed (u_B = 0, Eq. 23).
    stiffness, mass : csr_array, shape (len(free), len(free))
        K in N/m and M in kg, the thickness included.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.grid: TissueMesh | Tetrahedra
        if scene.tissue.mesh.file is None:
            self.grid = build_mesh(scene)
        else:
            self.grid = read_tetrahedra(scene)
        self.dimension = scene.dimension
        element = self._element = str(scene.tissue.mesh.element)
        self.basis = scalar_basis(self.grid.mesh, element)
        self.nodes = int(self.basis.N)
        depth = scene.tissue.thickness if scene.dimension == 2 else 1.0
        stiffness, mass = assemble(self.basis, element, MaterialField(scene))
        held = self._held()
        self.free: Index = np.flatnonzero(~held)
        self.position_of = np.full(len(held), -1, dtype=np.intp)
        self.position_of[self.free] = np.arange(len(self.free))
        self._compiled = None
        if isinstance(self.grid, TissueMesh) and compiled_grid.available(self.grid):
            dofs = self.basis.element_dofs
            self._compiled = compiled_grid.CompiledGrid(self.grid, dofs, self._local_nodes)
        self.stiffness = sp.csr_array(stiffness[self.free][:, self.free] * depth)
        self._scalar_mass = mass * depth

    @cached_property
    def mass(self) -> sp.csr_array:
        """Consistent mass matrix on the free unknowns, kg."""
        full = sp.csr_array(sp.kron(self._scalar_mass, np.eye(self.dimension)))
        return sp.csr_array(full[self.free][:, self.free])

    @property
    def coordinates(self) -> Vector:
        """Positions of the nodes, shape (d, n), m."""
        return np.asarray(self.basis.doflocs)

    def _held(self) -> NDArray[np.bool_]:
        """Tell which unknowns are zero: on fixed faces all, on rollers the normal ones."""
        if isinstance(self.grid, Tetrahedra):
            nodes = self.basis.get_dofs(facets=self.grid.fixed).flatten()
            return np.isin(np.arange(self.nodes), nodes).repeat(self.dimension)
        tissue, where = self.scene.tissue, self.basis.doflocs
        size = tissue.size
        slack = 1e-9 * max(size)
        planes = {
            "left": (0, -size[0] / 2),
            "right": (0, size[0] / 2),
            "bottom": (self.dimension - 1, -size[-1]),
        }
        if self.dimension == 3:
            planes |= {"front": (1, -size[1] / 2), "back": (1, size[1] / 2)}
        held = np.zeros((self.nodes, self.dimension), dtype=bool)
        for face in tissue.fixed or ():
            axis, value = planes[face]
            held[np.abs(where[axis] - value) < slack] = True
        if not held.any():
            raise SceneError("tissue.fixed", list(tissue.fixed or ()), "holds no node")
        for face in tissue.rollers:
            axis, value = planes[face]
            held[np.abs(where[axis] - value) < slack, axis] = True
        return held.ravel()

    @cached_property
    def elimination_order(self) -> Index | None:
        """Order in which to eliminate the free unknowns; None leaves it to the solver."""
        if self.dimension == 2:
            return None
        if isinstance(self.grid, Tetrahedra):
            return unknowns_order(self.stiffness, self.coordinates[:, self.free // 3])
        nodes = nested_dissection(self.grid.places(self.coordinates.T))
        unknowns = self.position_of[(self.dimension * nodes[:, None] + np.arange(3)).ravel()]
        return np.asarray(unknowns[unknowns >= 0])

    def shape_functions(self, points: Vector) -> tuple[Index, Vector, NDArray[np.bool_]]:
        """Evaluate the shape functions at points, shape (k, d).

        Returns
        -------
        nodes : ndarray of int, shape (k, b)
            Nodes of each point's cell.
        values : ndarray, shape (k, b)
            Their shape functions there.
        inside : ndarray of bool, shape (k,)
        """
        if self._compiled is not None:
            return self._compiled(points)
        cells, local, within = self.grid.locate(points)
        if self.grid.quadrilateral:
            values = self._tensor_product(local)
        else:
            element = self.basis.elem
            shapes = [element.lbasis(local, i)[0] for i in range(len(self.basis.basis))]
            values = np.array([np.broadcast_to(v, len(points)) for v in shapes])
        nodes = self.basis.element_dofs.take(cells, axis=1)
        return nodes.T.astype(np.intp, order="C"), values.T, within

    def _tensor_product(self, local: Vector) -> Vector:
        # Lagrange polynomials of each direction, multiplied as the element numbers its nodes
        quadratic = self._element == "quad2"
        lines = np.empty((3 if quadratic else 2, *local.shape))
        if quadratic:
            np.multiply(1 - local, 1 - 2 * local, out=lines[0])
            np.multiply(4 * local, 1 - local, out=lines[1])
            np.multiply(local, 2 * local - 1, out=lines[2])
        else:
            np.subtract(1, local, out=lines[0])
            lines[1] = local
        first, *others = self._local_nodes
        values = lines[:, 0].take(first, axis=0)
        for axis, order in enumerate(others, 1):
            values *= lines[:, axis].take(order, axis=0)
        return values

    @cached_property
    def _local_nodes(self) -> tuple[Index, ...]:
        steps = 2 if self._element == "quad2" else 1
        where = np.asarray(self.basis.elem.doflocs, dtype=float)
        return tuple(
            np.rint(steps * where[:, axis]).astype(np.intp) for axis in range(where.shape[1])
        )

    def sampling(self, points: Vector) -> sp.csr_array:
        """Return the matrix, shape (k d, free), that samples displacements at points (k, d)."""
        nodes, values, _ = self.shape_functions(points)
        d, count = self.dimension, len(points)
        rows = np.repeat(np.arange(count), nodes.shape[1])
        wide = (d * rows[:, None] + np.arange(d)).ravel()
        columns = (d * nodes.ravel()[:, None] + np.arange(d)).ravel()
        weights = np.repeat(values.ravel(), d)
        matrix = sp.coo_array((weights, (wide, columns)), shape=(d * count, d * self.nodes))
        return sp.csr_array(sp.csr_array(matrix)[:, self.free])
