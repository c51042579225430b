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
from needle_sim_ros.tissue.products import samples


class DirectCompliance(NodalCompliance):
    """Keeps no responses: each is solved for when asked, whatever came before."""

    _latest: tuple[Footprint, dict[int, Vector]] | None = None

    def prepare(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Do nothing: where the footprints will be is known when the track is laid."""
        return 0

    def ensure(self, nodes: Index, progress: Callable[[int, int], None] | None = None) -> int:
        """Do nothing."""
        return 0

    def expect(self, nodes: Index) -> None:
        """Do nothing."""

    def column(
        self, footprint: Footprint, component: int, at: Index, weights: Vector, starts: Index
    ) -> Vector:
        """Return the displacement (n d,) of other footprints per unit force; one solve."""
        if len(at) == 0:
            return np.empty(0)
        moved = expand(self._model, self._unit(footprint, component)).ravel()
        return samples(moved, at, weights, starts, self.dimension)

    def at_readers(self, footprint: Footprint) -> Vector:
        """Return the displacement at the readers, (r, d), after the columns without a solve."""
        columns = [self._unit(footprint, a) for a in range(self.dimension)]
        return np.asarray(self.reader_matrix @ np.stack(columns, axis=1))

    def _unit(self, footprint: Footprint, component: int) -> Vector:
        """Return the displacements (free,) under a unit force component on a footprint.

        Those of the footprint asked for last are kept.
        """
        if self._latest is None or self._latest[0] is not footprint:
            self._latest = (footprint, {})
        known = self._latest[1]
        if component not in known:
            axis = np.eye(self.dimension)[component]
            loads = np.multiply.outer(footprint.weights, axis)[:, None, :]
            known[component] = self._solved(footprint.nodes, loads)[:, 0]
        return known[component]

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
