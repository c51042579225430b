# SPDX-License-Identifier: Apache-2.0
"""What a command does to the needle base in a tick."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import CommandError
from needle_sim_ros.geometry import (
    Vector,
    conjugate,
    from_rotation_vector,
    multiply,
    to_rotation_vector,
)
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.scene import Scene

_STEEPEST = math.cos(math.radians(80))
# change of velocity, in proportion to the larger one, from which it counts as a jump
_JUMP = 0.2
_NO_TURN = np.zeros(3)


class BaseMotion(NamedTuple):
    """The base's motion in a tick.

    Attributes
    ----------
    position : ndarray, shape (3,)
        At the end, tissue frame, m.
    orientation : ndarray, shape (4,)
        At the end, quaternion x y z w; the object of before when the base does not turn.
    turning : ndarray, shape (3,)
        Rotation vector of the tick, tissue frame, rad.
    rate : tuple of float
        Velocity, m/s, and turning rate, rad/s, along x y z.
    place : tuple of float
        The position once more.
    length : float
        Of the way, m.
    """

    position: Vector
    orientation: Vector
    turning: Vector
    rate: tuple[float, ...]
    place: tuple[float, float, float]
    length: float

    @property
    def angle(self) -> float:
        """By which the base turns, rad."""
        return math.hypot(*self.turning) if any(self.rate[3:]) else 0.0


AT_REST = (0.0,) * 6


def commanded(command: BaseCommand, position: Vector, orientation: Vector, dt: float) -> BaseMotion:
    """Return what a command does to a base at a position (3,) and orientation (4,)."""
    after, quaternion, turning = position, orientation, _NO_TURN
    if command.position is not None:
        after = command.position
    elif command.velocity is not None:
        after = position + dt * command.velocity
    if command.orientation is not None:
        quaternion = command.orientation
        turning = to_rotation_vector(multiply(quaternion, conjugate(orientation)))
        if not turning.any():
            quaternion = orientation
    elif command.angular_velocity is not None and any(command.angular_velocity.tolist()):
        turning = dt * command.angular_velocity
        quaternion = multiply(from_rotation_vector(turning), orientation)
        quaternion = quaternion / np.linalg.norm(quaternion)
    x, y, z = place = tuple(after.tolist())
    if not math.isfinite(x + y + z):
        raise CommandError("the command takes the base to a place that is not finite")
    a, b, c = position.tolist()
    p, q, r = x - a, y - b, z - c
    u, v, w = (0.0, 0.0, 0.0) if turning is _NO_TURN else turning.tolist()
    rate = (p / dt, q / dt, r / dt, u / dt, v / dt, w / dt)
    return BaseMotion(after, quaternion, turning, rate, place, math.hypot(p, q, r))


def part_way(
    motion: BaseMotion, position: Vector, orientation: Vector, share: float
) -> tuple[Vector, Vector]:
    """Return position and orientation of the base after a share of its motion in a tick."""
    place = position + share * (motion.position - position)
    if motion.orientation is orientation:
        return place, orientation
    return place, multiply(from_rotation_vector(share * motion.turning), orientation)


def jumps(rate: tuple[float, ...], before: tuple[float, ...], length: float) -> bool:
    """Tell whether the base's velocity jumps at the start of a tick.

    Parameters
    ----------
    rate, before : tuple of float, shape (6,)
        Of the base in this tick and the last one.
    length : float
        Of turning, the speed at this length counts, m.
    """
    if rate == before:
        return False
    largest = change = 0.0
    for number, (now, then) in enumerate(zip(rate, before, strict=True)):
        scale = 1.0 if number < 3 else length
        largest = max(largest, scale * abs(now), scale * abs(then))
        change = max(change, scale * abs(now - then))
    return change > _JUMP * largest


def fastest(rate: tuple[float, ...], length: float) -> float:
    """Return the largest component of a rate, m/s; of turning, the speed at a length, m, counts."""
    x, y, z, u, v, w = rate
    return max(abs(x), abs(y), abs(z), length * max(abs(u), abs(v), abs(w)))


def check(
    scene: Scene,
    contact: ContactState,
    pose: BasePose,
    position: Vector,
    before: Vector,
    motion: BaseMotion,
) -> None:
    """Raise CommandError where the base must not go.

    Parameters
    ----------
    scene : Scene
    contact : ContactState
    pose : BasePose
        Before the tick.
    position : ndarray, shape (3,)
        Of the base before the tick, m.
    before : ndarray, shape (4,)
        Orientation before the tick.
    motion : BaseMotion
    """
    _, y, z = motion.place
    if scene.dimension == 2 and abs(y) > 1e-9:
        raise CommandError(f"a 2D scene moves in the plane y = 0, not to y = {y:g} m")
    turned = motion.orientation is not before
    touching = contact.touching or contact.inserted
    if turned:
        _check_orientation(motion.orientation, scene.dimension, touching)
    if not touching:
        return
    if z <= 0:
        raise CommandError(f"the base would enter the tissue, at z = {z:g} m")
    if contact.track is None:
        return
    if turned:
        pose = BasePose.of(motion.position, motion.orientation, scene.dimension)
    entry = contact.track.entry
    aside = _aside(motion.place, pose, entry)
    # who is that far already may come back
    if aside > scene.needle.length / 2 and aside > _aside(position.tolist(), pose, entry):
        raise CommandError(
            f"the base would be {aside:g} m beside the entry, more than half the needle"
        )


def _aside(position: Sequence[float], pose: BasePose, entry: list[float]) -> float:
    """Return how far the base is beside the entry, along the axis where it is most, m."""
    x, y, z = position
    away: tuple[float, ...] = (x - entry[0], z - entry[1])
    if len(entry) == 3:
        away = (x - entry[0], y - entry[1], z - entry[2])
    farthest = 0.0
    for axis in pose.terms[:-1]:
        along = 0.0
        for i, c in axis:
            along += away[i] * c
        farthest = max(farthest, abs(along))
    return farthest


def _check_orientation(quaternion: Vector, dimension: int, touching: bool) -> None:
    x, y, z, w = quaternion.tolist()
    # base y must stay normal to the plane
    if dimension == 2 and max(abs(x * y + z * w), abs(y * z - x * w)) > 5e-7:
        raise CommandError("a 2D scene turns about y only")
    if touching and 2 * (x * x + y * y) - 1 < _STEEPEST:
        raise CommandError("the needle would turn out of the tissue, over 80 deg from -z")
