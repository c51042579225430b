# SPDX-License-Identifier: Apache-2.0
"""The way of the base in a tick."""

from __future__ import annotations

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.tick.base_motion import AT_REST, BaseMotion, fastest, part_way


class Route:
    """The way of the base in a tick.

    Parameters
    ----------
    position : ndarray, shape (3,)
        Before the tick, tissue frame, m.
    orientation : ndarray, shape (4,)
        Before the tick, quaternion x y z w.
    pose : BasePose
        Before the tick.
    motion : BaseMotion
    duration : float
        Of the tick, s.
    rate : tuple of float
        Of the base in the tick before, as in BaseMotion.

    Attributes
    ----------
    motion : BaseMotion
    duration : float
        s.
    length : float
        Of the way, m.
    """

    __slots__ = (
        "_end",
        "_orientation",
        "_pose",
        "_position",
        "_rate",
        "duration",
        "length",
        "motion",
    )

    def __init__(
        self,
        position: Vector,
        orientation: Vector,
        pose: BasePose,
        motion: BaseMotion,
        duration: float,
        rate: tuple[float, ...] = AT_REST,
    ) -> None:
        self._rate, self.duration = rate, duration
        self._position, self._orientation = position, orientation
        self._pose, self.motion = pose, motion
        self._end = self._posed(motion.position, motion.orientation)
        self.length = motion.length

    @property
    def advance(self) -> float:
        """Of the way along the needle, m."""
        return self._pose.ahead(self._end)

    def swept(self, length: float) -> float:
        """Return how far the base goes and a needle of some length swings at most, m."""
        return self.length + length * self.motion.angle

    def fastest(self, length: float) -> float:
        """Return the speed of a needle of some length, or that before where it was faster, m/s.

        What the needle dragged along goes on as it did when the needle stops.
        """
        rate, now = self.motion.rate, fastest(self.motion.rate, length)
        return now if rate == self._rate else max(now, fastest(self._rate, length))

    def at(self, share: float) -> BasePose:
        """Return the pose after a part of the tick."""
        if share == 1.0:
            return self._end
        return self._posed(*part_way(self.motion, self._position, self._orientation, share))

    def _posed(self, position: Vector, orientation: Vector) -> BasePose:
        if orientation is self._orientation:
            return self._pose.moved_to(position)
        return BasePose.of(position, orientation, len(self._pose.axial))
