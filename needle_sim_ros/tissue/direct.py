# SPDX-License-Identifier: Apache-2.0
"""Responses of footprints instead of nodes, where too many nodes lie on the path.

On the finest grids a footprint covers hundreds of nodes. To keep the responses of each of
them to each other takes gigabytes and hours; those of the track points take d solves for
each new point, and nothing between.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.compliance import Footprint, NodalCompliance
from needle_sim_ros.tissue.dynamics import expand
from needle_sim_ros.tissue.mesh import Index


class DirectCompliance(NodalCompliance):
    """Keeps no responses: each is solved for when asked, whatever came before."""

    def prepare(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Do nothing: where the footprints will be is known when the track is laid."""
        return 0

    def ensure(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Do nothing."""
        return 0

    def expect(self, nodes: Index) -> None:
        """Do nothing."""

    def response(self, footprint: Footprint, at: Index) -> tuple[Vector, Vector]:
        """Return the response to unit forces spread by a footprint; d solves.

        Shapes as those of :meth:`NodalCompliance.response`.
        """
        loads = np.einsum("k,ab->kab", footprint.weights, np.eye(self.dimension))
        moved = self._solved(footprint.nodes, loads)
        at_nodes = np.stack([expand(self._model, u)[at] for u in moved.T])
        return at_nodes, np.asarray(self.reader_matrix @ moved)

    def displacement(self, loaded: Index, loads: Vector, footprint: Footprint) -> Vector:
        """Return the static displacement of a footprint, (d,), under loads; one solve."""
        moved = self._solved(loaded, loads[:, None, :])
        nodal = expand(self._model, moved[:, 0])
        return np.asarray(footprint.weights @ nodal[footprint.nodes])

    def _solved(self, nodes: Index, loads: Vector) -> Vector:
        """Return the displacements (free, c) under c cases of forces, loads (l, c, d)."""
        d, model = self.dimension, self._model
        places = model.position_of[(d * nodes[:, None] + np.arange(d)).ravel()]
        held = places >= 0
        right = np.zeros((len(model.free), loads.shape[1]), order="F")
        flat = loads.transpose(0, 2, 1).reshape(len(places), -1)
        for case, forces in enumerate(flat.T):
            np.add.at(right[:, case], places[held], forces[held])
        self.waits += 1
        return self._factor.solve(right)
