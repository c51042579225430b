# SPDX-License-Identifier: Apache-2.0
"""What the stage is told to do during one tick."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needle_sim_ros.errors import CommandError
from needle_sim_ros.geometry import with_finite_norm

Vector = NDArray[np.float64]


def _finite(name: str, value: ArrayLike | None, size: int) -> Vector | None:
    if value is None:
        return None
    try:
        array: Any = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise CommandError(f"{name} = {value!r}: must be {size} numbers") from None
    if array.shape != (size,):
        raise CommandError(f"{name} has shape {array.shape}: must be ({size},)")
    if not all(map(math.isfinite, array.tolist())):
        raise CommandError(f"{name} = {array.tolist()}: must be finite")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, init=False, eq=False)
class BaseCommand:
    """Motion of the needle base during one tick, in the tissue frame.

    Either a pose that the base reaches at the end of the tick, or a twist held
    for the tick. With nothing given the base stands still.

    Parameters
    ----------
    position : array_like, shape (3,), optional
        Base position at the end of the tick, m.
    orientation : array_like, shape (4,), optional
        Base orientation at the end of the tick, quaternion x y z w, base to tissue
        frame; normalised here.
    velocity : array_like, shape (3,), optional
        Linear velocity, m/s.
    angular_velocity : array_like, shape (3,), optional
        Angular velocity, rad/s.

    Raises
    ------
    CommandError
        On wrong shapes, non-finite numbers, a zero quaternion, or a pose and a twist
        at once.
    """

    position: Vector | None
    orientation: Vector | None
    velocity: Vector | None
    angular_velocity: Vector | None

    def __init__(
        self,
        position: ArrayLike | None = None,
        orientation: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
    ) -> None:
        pose = position is not None or orientation is not None
        twist = velocity is not None or angular_velocity is not None
        if pose and twist:
            raise CommandError("a command is either a pose or a twist, not both")
        quaternion = _finite("orientation", orientation, 4)
        if quaternion is not None:
            quaternion = np.array(with_finite_norm(quaternion.tolist()))
            norm = float(np.linalg.norm(quaternion))
            if norm < 1e-6:
                raise CommandError(f"orientation = {quaternion.tolist()}: zero quaternion")
            quaternion = quaternion / norm
            quaternion.flags.writeable = False
        object.__setattr__(self, "position", _finite("position", position, 3))
        object.__setattr__(self, "orientation", quaternion)
        object.__setattr__(self, "velocity", _finite("velocity", velocity, 3))
        object.__setattr__(
            self, "angular_velocity", _finite("angular_velocity", angular_velocity, 3)
        )
