# SPDX-License-Identifier: Apache-2.0
"""Fixed transforms between sensor frames and those of the model, on many rows at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needle_sim_ros.geometry import (
    Vector,
    from_rotation_vector,
    multiply,
    rotation_matrix,
    to_rotation_vector,
)


@dataclass(frozen=True)
class Transform:
    """Takes coordinates of one frame into another: rotate, then translate.

    Attributes
    ----------
    translation : tuple of 3 floats
        m.
    rotation : tuple of 4 floats
        Unit quaternion x y z w.
    """

    translation: tuple[float, ...] = (0.0, 0.0, 0.0)
    rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)

    @property
    def is_identity(self) -> bool:
        """Whether it changes nothing."""
        return self == Transform()

    def points(self, points: Vector) -> Vector:
        """Take points (..., 3) into the other frame."""
        turned = points @ rotation_matrix(self.rotation).T
        return np.asarray(turned + np.array(self.translation))

    def poses(self, poses: Vector) -> Vector:
        """Take poses (n, 7) into the other frame."""
        turned = [multiply(self.rotation, q) for q in poses[:, 3:]]
        return np.column_stack([self.points(poses[:, :3]), np.reshape(turned, (-1, 4))])

    def after(self, poses: Vector) -> Vector:
        """Return the poses (n, 7) of what is fixed to the moving frames by this transform."""
        arm = np.array(self.translation)
        places = [p[:3] + rotation_matrix(p[3:]) @ arm for p in poses]
        turned = [multiply(q, self.rotation) for q in poses[:, 3:]]
        return np.column_stack([np.reshape(places, (-1, 3)), np.reshape(turned, (-1, 4))])

    def vectors(self, vectors: Vector) -> Vector:
        """Turn vectors (..., 3)."""
        return np.asarray(vectors @ rotation_matrix(self.rotation).T)

    def wrenches(self, wrenches: Vector) -> Vector:
        """Take force and torque (n, 6) into the other frame, about its origin."""
        force, torque = self.vectors(wrenches[:, :3]), self.vectors(wrenches[:, 3:])
        return np.hstack([force, torque + np.cross(np.array(self.translation), force)])


def poses_at(times: Vector, known: Vector, poses: Vector) -> Vector:
    """Interpolate poses (n, 7) known at ascending times; held before the first, after the last.

    Positions linearly, orientations along the shortest turn.
    """
    unit = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1)[:, None]
    found = np.empty((len(times), 7))
    for axis in range(3):
        found[:, axis] = np.interp(times, known, poses[:, axis])
    if (unit == unit[0]).all():
        found[:, 3:] = unit[0]
        return found
    after = np.clip(np.searchsorted(known, times), 1, max(1, len(known) - 1))
    for row, (time, k) in enumerate(zip(times, after, strict=True)):
        span = known[k] - known[k - 1]
        part = min(max((time - known[k - 1]) / span, 0.0), 1.0) if span > 0 else 1.0
        inverse = unit[k - 1] * np.array([-1.0, -1.0, -1.0, 1.0])
        turning = part * to_rotation_vector(multiply(unit[k], inverse))
        found[row, 3:] = multiply(from_rotation_vector(turning), unit[k - 1])
    return found
