# SPDX-License-Identifier: Apache-2.0
"""The base in the coordinates of the mesh (x z in 2D, x y z in 3D)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needle_sim_ros.geometry import Vector, rotation_matrix


class BasePose(NamedTuple):
    """Pose of the needle base: Eqs. (12) and (15), as axes instead of angles.

    Attributes
    ----------
    origin : ndarray, shape (d,)
        The clamp.
    axial : ndarray, shape (d,)
        Unit vector along the undeflected needle.
    lateral : ndarray, shape (d - 1, d)
        Unit vectors of deflection: base x, and base y in 3D.
    terms : tuple of lists of (int, float)
        The components of each axis that are not zero: lateral ones, then axial.
    """

    origin: Vector
    axial: Vector
    lateral: Vector
    terms: tuple[list[tuple[int, float]], ...]

    @classmethod
    def of(cls, position: Vector, quaternion: Vector, dimension: int) -> BasePose:
        """Take the pose of the base, position (3,) and quaternion x y z w."""
        kept = [0, 2] if dimension == 2 else [0, 1, 2]
        rotation = rotation_matrix(quaternion)[kept]
        axial, lateral = rotation[:, 2].copy(), rotation[:, : dimension - 1].T.copy()
        terms = tuple(
            [(i, float(c)) for i, c in enumerate(axis) if c != 0.0] for axis in (*lateral, axial)
        )
        return cls(np.asarray(position)[kept], axial, lateral, terms)

    def moved_to(self, position: Vector) -> BasePose:
        """Return the pose with the clamp at another world position (3,)."""
        origin = position if len(self.axial) == 3 else position[::2]
        return BasePose(origin, self.axial, self.lateral, self.terms)

    def reach(self, point: list[float]) -> float:
        """Return the axial coordinate of one point (d), m from the clamp."""
        origin = self.origin.tolist()
        return sum([c * (point[i] - origin[i]) for i, c in self.terms[-1]])

    def ahead(self, other: BasePose) -> float:
        """Return how far another pose of the base is ahead along this one's axis, m."""
        return self.reach(other.origin.tolist())

    def cosine(self, direction: list[float]) -> float:
        """Return the cosine of the angle between the axis and a unit direction (d)."""
        return sum([c * direction[i] for i, c in self.terms[-1]])

    def along(self, point: Vector) -> Vector:
        """Return the axial coordinate of points (..., d), m from the clamp."""
        return np.asarray((point - self.origin) @ self.axial)

    def aside(self, point: Vector) -> Vector:
        """Return the lateral coordinates of points (..., d): shape (..., d - 1), m."""
        return np.asarray((point - self.origin) @ self.lateral.T)
