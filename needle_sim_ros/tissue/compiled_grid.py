# SPDX-License-Identifier: Apache-2.0
"""The shape functions of a grid at points by compiled code, where there is any.

A new track point asks for them in several ticks; what numpy does for it in forty calls,
`_grid.c` does in one, to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros import compiled
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.mesh import Index, TissueMesh

try:
    from needle_sim_ros.tissue import _grid
except ImportError:  # built without a compiler, or run from the source
    _grid = None  # type: ignore[assignment]


def available(grid: TissueMesh) -> bool:
    """Return whether there is compiled code for such a grid, and it is not switched off."""
    return grid.quadrilateral and _grid is not None and compiled.wanted()


class CompiledGrid:
    """Evaluates shape functions as :meth:`TissueModel.shape_functions` does.

    Parameters
    ----------
    grid : TissueMesh
        Of quadrilaterals or hexahedra.
    cells : ndarray of int, shape (b, cells)
        Their nodes.
    order : sequence of ndarray of int, shape (b,)
        For each direction, which of its polynomials makes a shape function.
    """

    def __init__(self, grid: TissueMesh, cells: Index, order: Sequence[Index]) -> None:
        self._lines = (
            tuple([(line.at, None if line.straight else line.drift) for line in grid.lateral]),
            grid.levels,
            np.array(order, dtype=np.intp),
            np.ascontiguousarray(cells, dtype=np.intc),
        )
        self._each = len(cells)

    def __call__(self, points: Vector) -> tuple[Index, Vector, NDArray[np.bool_]]:
        """Return nodes (k, b), shape functions (k, b), and whether points (k, d) are inside."""
        count = len(points)
        nodes = np.empty((count, self._each), dtype=np.intp)
        values = np.empty((count, self._each))
        inside = np.empty(count, dtype=np.bool_)
        points = np.ascontiguousarray(points, dtype=float)
        _grid.shape_functions(points, *self._lines, nodes, values, inside)
        return nodes, values, inside
