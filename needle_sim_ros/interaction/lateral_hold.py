# SPDX-License-Identifier: Apache-2.0
"""How tissue and needle give way to lateral forces on the held points, factorised once.

A needle clamped delta farther back is softer by what a turn and a shift of the clamp give:
C_n of Eq. (7) grows by (delta s s' + delta^2/2 (s 1' + 1 s') + delta^3/3 1 1') / E I. Until
the tip passes another point nothing else changes but the hold of the points within the bevel,
so a step takes one solve with a factor that is there already and a small system (the
identity of Sherman, Morrison and Woodbury).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.response import Axes, ResponseTable


def bending(arclength: Vector, softness: Vector, rigidity: float) -> Vector:
    """Return what lateral forces along one axis do to the needle and its hold, (k, k), m/N.

    Right on the diagonal and below it; above it is less than it should be.

    Parameters
    ----------
    arclength : ndarray, shape (k,)
        Of the points, rising, m.
    softness : ndarray, shape (k,)
        Of the hold, m/N.
    rigidity : float
        E I of the needle, N m^2.
    """
    # C_n = a^2 (b - a / 3) / 2EI: with a and b exchanged it is less by (b - a)^3 / 6EI
    bend = arclength[:, None] - arclength * (1.0 / 3.0)
    bend *= arclength * arclength * (0.5 / rigidity)
    bend.reshape(-1)[:: len(arclength) + 1] += softness
    return bend


class LateralHold:
    """Solves for the lateral forces of k held points, axis by axis.

    Parameters
    ----------
    table : ResponseTable
        Compliance of the tissue between the points of the track.
    axes : Axes
        Of the base: the lateral ones, then the axial one.
    arclength : ndarray, shape (k,)
        For which to factorise; best the least that will come, m.
    softness : ndarray, shape (k,)
        Of the hold there, best the least that will come, m/N.
    rigidity : float
        E I of the needle, N m^2.
    varying : int
        Number of last points whose softness will vary.

    Attributes
    ----------
    factor : ndarray, shape (m k, m k)
        Of the compliance, by Cholesky: column-major, its upper half.
    arclength : ndarray, shape (k,)
        As given, m.
    softness : ndarray, shape (varying,)
        Of the varying points, as given, m/N.

    Raises
    ------
    SolverError
        When the compliance is not positive definite.
    """

    def __init__(
        self,
        table: ResponseTable,
        axes: Axes,
        arclength: Vector,
        softness: Vector,
        rigidity: float,
        varying: int = 0,
    ) -> None:
        self._table, self._axes = table, axes
        self.arclength, self._rigidity = arclength, rigidity
        self._first = len(arclength) - varying
        self.softness = softness[self._first :]
        m, k = len(axes) - 1, len(arclength)
        matrix = bend = bending(arclength, softness, rigidity)
        if m == 1:
            matrix += table.along(axes, 0, 0)[:k, :k]
        else:
            matrix = np.empty((m * k, m * k))
            for a in range(m):
                rows = slice(a * k, (a + 1) * k)
                for b in range(a + 1):
                    matrix[rows, b * k : (b + 1) * k] = table.along(axes, a, b)[:k, :k]
                matrix[rows, rows] += bend
        # row-major lower is column-major upper
        self.factor, info = lapack.dpotrf(matrix.T, lower=0, clean=0, overwrite_a=1)
        if info != 0:
            raise SolverError("the lateral compliance is not positive definite")
        self._change: tuple[Vector, Vector, Vector] | None = None

    def serves(self, table: ResponseTable, axes: Axes, held: int) -> bool:
        """Return whether it is that of the first so many points of a table, along the axes."""
        same = axes is self._axes and held == len(self.arclength)
        return same and table.shares(self._table, held)

    def forces(self, gaps: Vector, arclength: Vector, softness: Vector) -> Vector:
        """Return the lateral forces that close the gaps, shape (m k,), N.

        Parameters
        ----------
        gaps : ndarray, shape (m k,)
            m; overwritten.
        arclength, softness : ndarray, shape (k,)
            Of now; all arclengths differ by the same from those factorised.
        """
        forces, _ = lapack.dpotrs(self.factor, gaps, lower=0, overwrite_b=1)
        if arclength is self.arclength:
            return np.asarray(forces)
        kinds, answers, products = self.changes()
        m, count = len(self._axes) - 1, len(products)
        weights = np.zeros((count // m, count // m))
        farther = float(arclength[0] - self.arclength[0])
        turn = farther / self._rigidity
        weights[0, 0] = turn
        weights[0, 1] = weights[1, 0] = turn * farther / 2.0
        weights[1, 1] = turn * farther * farther / 3.0
        softer = weights.reshape(-1)[2 * len(weights) + 2 :: len(weights) + 1]
        softer[:] = softness[self._first :]
        softer -= self.softness
        system = (weights @ products.reshape(m, -1, count)).reshape(count, count)
        system.reshape(-1)[:: count + 1] += 1.0
        load = weights @ (kinds @ forces).reshape(m, -1, 1)
        _, _, amounts, info = lapack.dgesv(system, load.ravel(), overwrite_a=1, overwrite_b=1)
        if info != 0:
            raise SolverError("the lateral compliance is singular")
        return np.asarray(forces - amounts @ answers)

    def changes(self) -> tuple[Vector, Vector, Vector]:
        """Return the kinds of change, (q, m k), the answers to them, and their products (q, q).

        Along each axis: a turn and a shift of the clamp, and the hold of each varying point.
        """
        if self._change is None:
            m, k = len(self._axes) - 1, len(self.arclength)
            along = np.zeros((2 + k - self._first, k))
            along[0], along[1] = self.arclength, 1.0
            along[2:, self._first :] = np.eye(k - self._first)
            each = np.zeros((m, len(along), m, k))
            for a in range(m):
                each[a, :, a] = along
            kinds = each.reshape(m * len(along), m * k)
            answers = lapack.dpotrs(self.factor, kinds.T, lower=0)[0].T
            self._change = kinds, answers, np.asarray(kinds @ answers.T)
        return self._change
