# SPDX-License-Identifier: Apache-2.0
"""Rotations and poses on plain arrays: quaternions are x y z w, base to tissue frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
_HUGE = 1e150  # the norm of larger components may be beyond the largest number


def with_finite_norm(quaternion: Sequence[float]) -> Sequence[float]:
    """Return finite components of a quaternion, scaled where its norm would overflow."""
    largest = max(map(abs, quaternion))
    return [q / largest for q in quaternion] if largest > _HUGE else quaternion


def rotation_matrix(quaternion: ArrayLike) -> Vector:
    """Return the rotation matrix, shape (3, 3), of a unit quaternion x y z w."""
    x, y, z, w = (float(c) for c in np.asarray(quaternion))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def multiply(a: ArrayLike, b: ArrayLike) -> Vector:
    """Return the quaternion product a b: the rotation b followed by the rotation a."""
    ax, ay, az, aw = (float(c) for c in np.asarray(a))
    bx, by, bz, bw = (float(c) for c in np.asarray(b))
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def conjugate(quaternion: ArrayLike) -> Vector:
    """Return the inverse rotation of a unit quaternion."""
    q = np.asarray(quaternion, dtype=float)
    return np.array([-q[0], -q[1], -q[2], q[3]])


def from_rotation_vector(vector: ArrayLike) -> Vector:
    """Return the quaternion of a rotation by |vector| radians about the vector."""
    v = np.asarray(vector, dtype=float)
    angle = math.sqrt(float(v @ v))
    # sin(a/2)/a by its series where the quotient would lose digits
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else math.sin(angle / 2) / angle
    return np.array([*(scale * v), math.cos(angle / 2)])


def to_rotation_vector(quaternion: ArrayLike) -> Vector:
    """Return the rotation vector (rad) of a unit quaternion, the short way round."""
    q = np.asarray(quaternion, dtype=float)
    if q[3] < 0:
        q = -q
    sine = float(np.linalg.norm(q[:3]))
    if sine < 1e-12:
        return np.asarray(2 * q[:3])
    return np.asarray(q[:3] * (2 * math.atan2(sine, float(q[3])) / sine))


def turn(quaternion: ArrayLike, angular_velocity: ArrayLike, duration: float) -> Vector:
    """Turn an orientation by an angular velocity (rad/s, tissue frame) held for a duration."""
    step = from_rotation_vector(np.asarray(angular_velocity, dtype=float) * duration)
    turned = multiply(step, quaternion)
    return np.asarray(turned / np.linalg.norm(turned))


def normals(direction: Vector) -> Vector:
    """Return two unit vectors perpendicular to a unit direction (3,) and to each other, (2, 3)."""
    x, y, z = direction.tolist()
    first = [1 - x * x, -x * y, -x * z] if abs(x) < 0.8 else [-x * y, 1 - y * y, -y * z]
    a, b, c = (part / math.hypot(*first) for part in first)
    return np.array([[a, b, c], [y * c - z * b, z * a - x * c, x * b - y * a]])
