# SPDX-License-Identifier: Apache-2.0
"""What the mesh in 3D cannot show of the tissue about the needle, from Kelvin's solution.

A needle is thinner than the cells about it, and a force spread over its cross-section moves
the tissue there far more than the mesh can: to leave that to refinement takes cells of a third
of its radius. So the mesh bears the forces on a wider disc, which its cells show, and what the
narrow disc does beyond that is added in closed form. The difference of two forces of the same
resultant falls with the cube of the distance: only neighbours on the track feel it, and the
sides of the tissue and what the readers see have no part in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from needle_sim_ros.geometry import Vector, normals
from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.material import MaterialField
from needle_sim_ros.tissue.mesh import spacings

# how far the difference is followed, in radii of the wide disc: a thousandth of it is left
_REACH = 6.0
# points of Gauss's rule over the distances in a disc, and over an eighth of a spacing
_ON_DISC, _ON_PIECE = 200, 6
_PIECES = 8  # to a spacing
# places on a side of a hat, from its point, and what they weigh
_GAUSS, _GAUSS_WEIGHT = np.polynomial.legendre.leggauss(2)
_SHARES = 0.5 * (_GAUSS + 1)
_HAT_WEIGHT = 0.5 * _GAUSS_WEIGHT * (1 - _SHARES)
# places on the disc of radius 1 with its moments up to the fifth
_RING = np.pi / 3 * np.arange(6)
_AROUND = np.column_stack([np.cos(_RING), np.sin(_RING)])
_DISC = (np.sqrt(_SHARES)[:, None, None] * _AROUND).reshape(-1, 2)
# weights of the places of two discs, the wide one taken off, on both sides of a hat
_DISC_WEIGHT = np.array([1.0, -1.0]).repeat(len(_DISC)) / len(_DISC)
_HAT_PLACES_WEIGHT = (_HAT_WEIGHT.repeat(2)[:, None] * _DISC_WEIGHT).ravel()


def disc_radius(scene: Scene) -> float:
    """Return the radius of the disc over which the mesh bears the needle's forces, m.

    The needle's own, or in 3D the spacing of the nodes across where that is wider.
    """
    radius = scene.needle.radius
    if scene.dimension == 2 or scene.tissue.mesh.file is not None:
        return radius
    nodes = 2 if str(scene.tissue.mesh.element).endswith("2") else 1
    return max(radius, spacings(scene)[0] / nodes)


def _distances(lag: Vector, radius: float) -> Vector:
    """Return means over pairs of places of two equal discs, a lag (n,) apart, shape (3, n).

    Of 1 / rho, half of d^2 / rho^3, and lag^2 / rho^3, with d the distance across and rho the
    whole one; d has the density of disc line picking.
    """
    x, weight = np.polynomial.legendre.leggauss(_ON_DISC)
    # both ends are approached with zero slope, where the integrands are singular
    part, slope = 0.25 * (2 + 3 * x - x**3), 0.75 * (1 - x**2)
    d = 2 * radius * part
    density = 2 * d / (math.pi * radius**2) * (2 * np.arccos(part) - np.sin(2 * np.arccos(part)))
    share = density * weight * slope * 2 * radius
    rho = np.sqrt(d**2 + lag[:, None] ** 2)
    return np.array(
        [(1 / rho) @ share, (0.5 * d**2 / rho**3) @ share, lag**2 * ((1 / rho**3) @ share)]
    )


class Turning(NamedTuple):
    """How forces on the last points of a track turn the tissue, as far as the mesh does not show.

    Attributes
    ----------
    first : int
        Number of the first of these points.
    aside, along : ndarray, shape (n,)
        By a force in any direction, and by its part along the track besides, 1/N.
    direction : ndarray, shape (3,)
        Unit vector along the track.
    """

    first: int
    aside: Vector
    along: Vector
    direction: Vector

    def by(self, forces: Vector) -> Vector:
        """Return how forces on all points, (n, 3), turn it, (3,); new points may bear none yet."""
        forces = forces[self.first : self.first + len(self.aside)]
        aside, along = self.aside[: len(forces)], self.along[: len(forces)]
        axial = along @ (forces @ self.direction)
        return np.asarray(aside @ forces + axial * self.direction)


class NearField:
    """Adds what a disc of the needle's radius does beyond a wider one.

    Parameters
    ----------
    scene : Scene
        Three-dimensional.

    Attributes
    ----------
    wide : float
        Radius of the disc that the mesh bears, m.
    """

    def __init__(self, scene: Scene) -> None:
        self._radius, self.wide = scene.needle.radius, disc_radius(scene)
        self._material = MaterialField(scene)
        # where there are no regions nothing has to be looked up
        self._uniform = None if scene.tissue.regions else self._elastic_at(np.zeros((1, 3)))
        spacing = self._spacing = scene.solver.track_spacing
        self._lags = math.ceil(_REACH * self.wide / spacing) + 2
        # means over a section and the hats about it, at lags of an eighth of a spacing
        step = spacing / _PIECES
        count = (self._lags + 4) * _PIECES
        self._step, self._reach = step, step * count
        x, weight = np.polynomial.legendre.leggauss(_ON_PIECE)
        starts = step * np.arange(-count - 2 * _PIECES, count + 2 * _PIECES)
        places = (starts[:, None] + 0.5 * step * (x + 1)).ravel()
        weights = np.tile(0.5 * step * weight, len(starts))
        excess = _distances(np.abs(places), self._radius) - _distances(np.abs(places), self.wide)
        self._hat = np.array(
            [
                (excess * (weights * _hat(places - s * step, spacing))).sum(1)
                for s in range(count + 1)
            ]
        )
        self._rise = np.diff(self._hat, axis=0)
        lags = spacing * np.arange(self._lags)
        self._hats = np.array(
            [(excess * (weights * _hats(places - s, spacing))).sum(1) for s in lags]
        )

    def row(self, points: Vector, point: Vector, direction: Vector) -> Vector:
        """Return what is added to the response of points to a force on another one.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            The track so far, m; the first of them, if any, is the entry.
        point, direction : ndarray, shape (3,)
            The new point, and the unit direction of the track there.

        Returns
        -------
        ndarray, shape (3 (n + 1), 3)
            m/N; of the new point itself last.
        """
        count = len(points)
        added = np.zeros((count + 1, 3, 3))
        if count == 0:
            added[0] = self._entry(point, direction)
            return added.reshape(-1, 3)
        first = max(0, count + 1 - self._lags)
        kelvin = self._hats[: count + 1 - first][::-1].copy()
        if first == 0:
            kelvin[0] = self._hat[count * _PIECES]
        apart = np.vstack([point - points[first:], direction])
        apart /= np.sqrt((apart**2).sum(axis=1))[:, None]
        aside, along = self._compliance(kelvin, np.vstack([points[first:], point]), point)
        across = aside[:, None, None] * np.eye(3)
        added[first:] = across + (along - aside)[:, None, None] * apart[:, :, None] * apart[:, None]
        return added.reshape(-1, 3)

    def at(self, places: Vector, before: Vector, point: Vector, after: Vector) -> Vector:
        """Return what is added to the response of other places to a force on a track point.

        Parameters
        ----------
        places : ndarray, shape (m, 3)
            m.
        before, point, after : ndarray, shape (3,)
            The point and its neighbours on the track, m.

        Returns
        -------
        ndarray, shape (3 m, 3)
            m/N.
        """
        added = np.zeros((len(places), 3, 3))
        close = np.flatnonzero(((places - point) ** 2).sum(axis=1) < (_REACH * self.wide) ** 2)
        if not len(close):
            return added.reshape(-1, 3)
        sides = np.array([before, after]) - point
        along = (point + _SHARES[:, None, None] * sides).reshape(-1, 3)
        disc = _DISC @ normals(sides[1] / math.sqrt(float(sides[1] @ sides[1])))
        discs = np.concatenate([self._radius * disc, self.wide * disc])
        factor, bulk = self._elastic_between(places[close], point)
        d = places[close][:, None] - (along[:, None] + discs).reshape(-1, 3)
        square = (d * d).sum(axis=2)
        share = _HAT_PLACES_WEIGHT / np.sqrt(square)
        summed = share.sum(axis=1)
        share /= square
        outer = (d * share[:, :, None]).transpose(0, 2, 1) @ d
        added[close] = (factor * bulk * summed)[:, None, None] * np.eye(3)
        added[close] += factor[:, None, None] * outer
        return added.reshape(-1, 3)

    def turning(self, points: Vector, place: Vector, direction: Vector, length: float) -> Turning:
        """Return what is added to how forces on points turn the tissue ahead of a place.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            Of the track, m.
        place, direction : ndarray, shape (3,)
            On the track, m, and its unit direction there.
        length : float
            Over which the tissue is turned, m.
        """
        first = max(0, len(points) - self._lags)
        points = points[first:]
        if not len(points):
            return Turning(0, np.zeros(0), np.zeros(0), direction)
        ends = np.array([place + length * direction, place])
        lag = np.abs(ends @ direction - (points @ direction)[:, None])
        kelvin = self._kelvin(lag)
        aside, along = self._compliance(kelvin[:, 0] - kelvin[:, 1], points, points[-1])
        return Turning(first, aside / length, (along - aside) / length, direction)

    def _kelvin(self, lag: Vector) -> Vector:
        """Interpolate between the means over a section and the hats about it, (..., 3), 1/m."""
        places = lag * (1.0 / self._step)
        whole = np.minimum(places.astype(np.intp), len(self._rise) - 1)
        found = self._hat[whole] + (places - whole)[..., None] * self._rise[whole]
        found[lag > self._reach] = 0.0
        return np.asarray(found)

    def _compliance(self, kelvin: Vector, places: Vector, other: Vector) -> tuple[Vector, Vector]:
        """Return the compliance across and along the track, (n,), of places to another one."""
        factor, bulk = self._elastic_between(places, other)
        across = factor * (bulk * kelvin[:, 0] + kelvin[:, 1])
        return across, factor * (bulk * kelvin[:, 0] + kelvin[:, 2])

    def _elastic_between(self, places: Vector, other: Vector) -> Vector:
        """Return the constants of Kelvin's solution from a place (3,) to others (n, 3).

        Shape (2, n), or (2, 1) where they are the same everywhere.
        """
        if self._uniform is not None:
            return self._uniform
        own = self._elastic_at(np.vstack([places, other]))
        return np.asarray(0.5 * (own[:, :-1] + own[:, -1:]))

    def _elastic_at(self, places: Vector) -> Vector:
        """Return 1 / (16 pi G (1 - nu)) and 3 - 4 nu at places (n, 3), shape (2, n)."""
        material = self._material(places.T)
        ratio = material.lame / (2 * (material.lame + material.shear))
        return np.array([1 / (16 * math.pi * material.shear * (1 - ratio)), 3 - 4 * ratio])

    def _entry(self, point: Vector, direction: Vector) -> Vector:
        """Return what is added for a cross-section in the surface, (3, 3), m/N.

        The mean displacement of a disc of radius a under uniform traction on a half-space is
        16 (1 - nu^2) / (3 pi^2 E a) of the force normal to it, and (2 - nu) / (2 - 2 nu)
        times that tangential to it.
        """
        material = self._material(point[:, None])
        lame, shear = float(material.lame[0]), float(material.shear[0])
        ratio = lame / (2 * (lame + shear))
        normal = 8 * (1 - ratio) / (3 * math.pi**2 * shear) * (1 / self._radius - 1 / self.wide)
        return normal * np.diag([(2 - ratio) / (2 - 2 * ratio)] * 2 + [1.0])


def _hat(offset: Vector, spacing: float) -> Vector:
    """Return the density of a hat at offsets from its point, 1/m."""
    return np.asarray(np.maximum(1 - np.abs(offset) / spacing, 0.0) / spacing)


def _hats(offset: Vector, spacing: float) -> Vector:
    """Return the density of the offsets between places of two hats, 1/m."""
    u = np.abs(offset) / spacing
    inner, outer = 2 / 3 - u**2 + u**3 / 2, (2 - u) ** 3 / 6
    return np.asarray(np.where(u < 1, inner, np.where(u < 2, outer, 0.0)) / spacing)
