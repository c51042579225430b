# SPDX-License-Identifier: Apache-2.0
"""Makes organ.msh: a rounded, flattened lump with a tumour, held at its lower side.

    python config/meshes/organ.py [FILE]

A cube of tetrahedra, finer about the middle, is bent towards a ball and stretched. In mm;
volumes `parenchyma` and `tumour`, faces `bottom`.
"""

import sys
from pathlib import Path

import meshio
import numpy as np
import skfem

CELLS = (10, 10, 9)
HALF_AXES = np.array([60.0, 45.0, 30.0])  # mm
ROUND = 0.8  # 0 a box, 1 an ellipsoid
TUMOUR = (np.array([6.0, 0.0, 0.0]), 13.0)  # middle and radius, mm
HELD_BELOW = -18.0  # mm


def organ() -> meshio.Mesh:
    """Return the mesh, its middle at the origin."""
    lines = [np.linspace(-1.0, 1.0, count + 1) for count in CELLS]
    lines[:2] = [np.sign(t) * np.abs(t) ** 1.4 for t in lines[:2]]
    cube = skfem.MeshTet.init_tensor(*lines)
    p = cube.p
    length = np.linalg.norm(p, axis=0)
    ball = p * np.abs(p).max(axis=0) / np.where(length > 0, length, 1.0)
    points = (ROUND * ball + (1 - ROUND) * p).T * HALF_AXES
    cells = cube.t.T.copy()
    turned = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0
    cells[turned, 2:] = cells[turned, :1:-1]
    middles = points[cells].mean(axis=1)
    tumour = np.linalg.norm(middles - TUMOUR[0], axis=1) < TUMOUR[1]
    faces = cube.facets[:, cube.boundary_facets()].T
    faces = faces[points[faces].mean(axis=1)[:, 2] < HELD_BELOW]
    tags = [np.where(tumour, 2, 1), np.full(len(faces), 3)]
    return meshio.Mesh(
        np.round(points, 4),
        [("tetra", cells), ("triangle", faces)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={
            "parenchyma": np.array([1, 3]),
            "tumour": np.array([2, 3]),
            "bottom": np.array([3, 2]),
        },
    )


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("organ.msh")
    meshio.write(target, organ(), file_format="gmsh22", binary=True)
