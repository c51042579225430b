# SPDX-License-Identifier: Apache-2.0
"""Where the needle touches the tissue: means over its cross-section along the track.

P_k u = int phi_k <u> ds / int phi_k ds, with phi_k the hat function of track point k and
<u> the mean over the cross-section perpendicular to the track: in 2D the chord of length
2 r, in 3D the disc of radius r. The entry has no hat above the surface: it takes the
cross-section itself. The same operator samples displacement (K_StoP, Eqs. 18 and 19) and
spreads force (K_PtoS, its transpose, Eqs. 20 and 21), so action and reaction agree, and a
limit under refinement exists, which point forces do not have.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from needle_sim_ros.geometry import Vector, normals
from needle_sim_ros.tissue.compliance import Footprint
from needle_sim_ros.tissue.mesh import Index, spacings
from needle_sim_ros.tissue.model import TissueModel

# least points of quadrature, and for each cell of the mesh: fewer act as forces on points
_ON_CHORD, _ON_SIDE, _PER_CELL = 8, 3, 2
# in 3D rings of equal angles, Gauss's rule in the square of the radius
_RINGS, _RING_WEIGHT = np.polynomial.legendre.leggauss(3)
_ANGLES = (np.arange(8) + 0.5) * (np.pi / 4)
# the disc of radius 1 by two normals (places, 2), and the weights of its places
_RADII = np.repeat(np.sqrt(0.5 * (_RINGS + 1)), len(_ANGLES))
_DISC = _RADII[:, None] * np.tile(np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)]), (3, 1))
_DISC_WEIGHT = np.repeat(0.5 * _RING_WEIGHT / len(_ANGLES), len(_ANGLES))
# range of node numbers up to which an array with a place for each is cheaper than sorting
_NUMBERS = 20_000
# places along the track ahead of the tip at which its needs are foreseen
_AHEAD = 8


class Shares(NamedTuple):
    """What a footprint is made of: nodes (k, b) about k places, and their weights (k, b)."""

    nodes: Index
    weights: Vector


class Coupling:
    """Makes footprints on the mesh of a tissue.

    Parameters
    ----------
    model : TissueModel
    radius : float
        Needle radius r, m.
    """

    def __init__(self, model: TissueModel, radius: float) -> None:
        self._model, self.radius = model, radius
        across, along, _ = spacings(model.scene)
        self._along_spacing = along
        count = max(_ON_CHORD, math.ceil(_PER_CELL * 2 * radius / across))
        self._chord, self._chord_weight = np.polynomial.legendre.leggauss(count)
        count = max(_ON_SIDE, math.ceil(_PER_CELL * model.scene.solver.track_spacing / along))
        self._along, self._along_weight = np.polynomial.legendre.leggauss(count)

    def hat(self, before: Vector, point: Vector, after: Vector) -> Footprint:
        """Return the footprint of a track point; parameters as of :meth:`hat_shares`."""
        return added_up(self.hat_shares(before, point, after))

    def hat_shares(self, before: Vector, point: Vector, after: Vector) -> Shares:
        """Return what the footprint of a track point is made of.

        Parameters
        ----------
        before, point, after : ndarray, shape (d,)
            Reference positions of the neighbours and of the point, m.
        """
        places, weights = [], []
        for other in (before, after):
            span = other - point
            part = 0.5 * (self._along + 1)  # 0 at the point, 1 at the neighbour
            length = math.sqrt(float(span @ span))
            section, share = self._section(span / length)
            along = point + part[:, None] * span
            places.append((along[:, None, :] + section[None, :, :]).reshape(-1, len(point)))
            hat = 0.5 * self._along_weight * (1 - part) * length
            weights.append((hat[:, None] * share[None, :]).ravel())
        return self._shares(np.concatenate(places), np.concatenate(weights))

    def section(self, point: Vector, direction: Vector) -> Footprint:
        """Return the mean over one cross-section, perpendicular to a unit direction (d,)."""
        section, share = self._section(direction)
        return added_up(self._shares(point + section, share))

    def ahead(self, point: Vector, direction: Vector, reach: float) -> Index:
        """Return the nodes that a track from a point along a unit direction will touch.

        Some of them several times.
        """
        # no layer of elements may be missed
        count = max(_AHEAD, 1 + math.ceil(reach / self._along_spacing))
        steps = np.linspace(0.0, reach, count)[:, None, None] * direction
        section, _ = self._section(direction)
        places = (point + steps + section[None, :, :]).reshape(-1, len(point))
        nodes, values, inside = self._model.shape_functions(places)
        return nodes[inside][np.abs(values[inside]) > 1e-12]

    def turning(self, point: Vector, direction: Vector, length: float) -> Shares:
        """Return what tells how the mean displacement changes per length along a direction.

        Cross-sections at a point and a length ahead of it; weights add up to zero.
        """
        section, share = self._section(direction)
        places = np.concatenate([point + section, point + length * direction + section])
        nodes, values, inside = self._model.shape_functions(places)
        weights = np.concatenate([-share, share])
        weights[~inside] = 0.0
        ends = len(share)
        before, after = -weights[:ends].sum(), weights[ends:].sum()
        if before <= 0 or after <= 0:  # one of them lies outside: nothing to compare
            return Shares(nodes[:1, :1], np.zeros((1, 1)))
        weights[:ends] /= before * length
        weights[ends:] /= after * length
        return Shares(nodes, values * weights[:, None])

    def _section(self, direction: Vector) -> tuple[Vector, Vector]:
        if len(direction) == 3:
            return self._disc(direction)
        normal = np.array([-direction[1], direction[0]])
        return self.radius * self._chord[:, None] * normal, 0.5 * self._chord_weight

    def _disc(self, direction: Vector) -> tuple[Vector, Vector]:
        # which normals to the track hardly matters to a mean over the disc
        return self.radius * (_DISC @ normals(direction)), _DISC_WEIGHT

    def _shares(self, places: Vector, weights: Vector) -> Shares:
        nodes, values, inside = self._model.shape_functions(places)
        # a cross-section at the surface or a side counts with the part in the tissue
        if not inside.all() and inside.any():
            nodes, values, weights = nodes[inside], values[inside], weights[inside]
        return Shares(nodes, values * (weights / weights.sum())[:, None])


def added_up(shares: Shares) -> Footprint:
    """Return the footprint that shares make; nodes that get nothing are left out."""
    flat, given = shares.nodes.ravel(), shares.weights.ravel()
    lowest = int(flat.min())
    if int(flat.max()) - lowest < _NUMBERS:
        total = np.asarray(np.bincount(flat - lowest, weights=given), dtype=float)
        keep = _noted(total)
        return Footprint(keep + lowest, total.take(keep))
    merged, where = np.unique(flat, return_inverse=True)
    total = np.asarray(np.bincount(where.ravel(), weights=given), dtype=float)
    keep = _noted(total)
    return Footprint(merged.take(keep), total.take(keep))


def _noted(total: Vector) -> Index:
    """Return which entries are more than rounding."""
    size = np.abs(total)
    return np.flatnonzero(size >= 1e-14 * size.max())
