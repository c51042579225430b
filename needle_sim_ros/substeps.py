# SPDX-License-Identifier: Apache-2.0
"""A tick in parts: how finely the contact follows the base's way.

The tissue moves on once in a time step of Newmark's method; the contact may find its balance
more often, so that track and friction do not hang on how far the base goes in a step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from needle_sim_ros.base_motion import (
    AT_REST,
    BaseMotion,
    fastest,
    half_spacings,
    part_way,
    static_steps,
    unsteady_steps,
)
from needle_sim_ros.errors import CommandError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.contact import FreeRows
from needle_sim_ros.interaction.friction import creep
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.scene import Friction, Scene
from needle_sim_ros.tissue.response import ResponseTable
from needle_sim_ros.tissue.waves import slowest_period

# how far the needle may go in and out in one time step of Newmark's method, in track spacings:
# beyond, the tissue's motion on the way is not followed
_FARTHEST_IN, _FARTHEST_OUT = 2, 4
# how far the base may go in one that is shorter than the slowest wave's period, in depths of
# the tissue: beyond, what the wave that it sends does to friction is not resolved
_FARTHEST = 0.02
_AT_ITS_END = (1.0,)
# slip that counts no more, in weakening distances
_HEALED_OFF = 1e-3


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
    rate : tuple of float
        Of the base in the tick before, as in BaseMotion.

    Attributes
    ----------
    motion : BaseMotion
    length : float
        Of the way, m.
    """

    __slots__ = ("_end", "_orientation", "_pose", "_position", "_rate", "length", "motion")

    def __init__(
        self,
        position: Vector,
        orientation: Vector,
        pose: BasePose,
        motion: BaseMotion,
        rate: tuple[float, ...] = AT_REST,
    ) -> None:
        self._rate = rate
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
        return self.length + length * math.hypot(*self.motion.turning)

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


def equal_parts(
    scene: Scene,
    contact: ContactState,
    route: Route,
    jump: bool,
    dt: float,
) -> int:
    """Return into how many equal parts a quasi-static tick falls.

    Parameters
    ----------
    scene : Scene
    contact : ContactState
    route : Route
        Of the base in the tick.
    jump : bool
        Whether the velocity of base or tissue jumps.
    dt : float
        s.
    """
    motion = route.motion
    if not (contact.inserted or contact.touching) and motion.rate[2] > 0:
        return 1
    steps = static_steps(motion, scene.solver.track_spacing)
    if contact.inserted:
        return _unsteady(scene, scene.interaction.friction, contact, route, 1.0, dt, jump, steps)
    return steps


def _unsteady(
    scene: Scene,
    friction: Friction,
    contact: ContactState,
    route: Route,
    share: float,
    dt: float,
    jump: bool,
    steps: int,
) -> int:
    """Return into how many parts the time falls in which friction changes, or as many as given."""
    finer = unsteady_steps(route.fastest(scene.needle.length), share * dt, friction, steps)
    if finer == steps or jump or not contact.status[:-1].all():
        return finer
    whole, slip = friction.weakening_distance, contact.slip
    heals = slip > _HEALED_OFF * whole
    if abs(route.advance) > creep(friction) * dt:
        heals &= slip < whole
    return finer if heals.any() else steps


class Reach(NamedTuple):
    """How far the base may go in one time step of Newmark's method while the needle is inserted.

    Attributes
    ----------
    spacing : float
        Of the track, m.
    way : float
        In any direction, turning included, m.
    why : str
        Where that is bounded.
    """

    spacing: float
    way: float
    why: str

    @classmethod
    def of(cls, scene: Scene) -> Reach:
        """Work out that of a scene."""
        period, depth = slowest_period(scene.tissue), scene.tissue.size[-1]
        if scene.solver.time_step >= period:
            return cls(scene.solver.track_spacing, math.inf, "")
        why = f"{_FARTHEST:.0%} of the tissue's depth, while its slowest wave takes {period:.3g} s"
        return cls(scene.solver.track_spacing, _FARTHEST * depth, why)

    def check(self, contact: ContactState, advance: float, way: float) -> None:
        """Raise CommandError where a time step takes the needle too far.

        Parameters
        ----------
        contact : ContactState
        advance, way : float
            Of the base in the step, along the needle and in all, m.
        """
        if not contact.inserted:
            return
        most = _FARTHEST_IN if advance > 0 else _FARTHEST_OUT
        if abs(advance) > most * self.spacing * (1 + 1e-9):
            raise CommandError(
                f"the needle would go {abs(advance):g} m in one time step, more than {most} times "
                f"solver.track_spacing ({self.spacing:g} m): solver.time_step is too long for it"
            )
        if way > self.way * (1 + 1e-9):
            raise CommandError(
                f"the base would go {way:g} m in one time step, more than {self.way:g} m, "
                f"{self.why}: solver.time_step is too long for it"
            )


def parts_of_step(
    scene: Scene,
    friction: Friction,
    contact: ContactState,
    route: Route,
    share: float,
    dt: float,
    jump: bool,
) -> int:
    """Return in how many equal parts the contact follows a time step of Newmark's method.

    Parameters
    ----------
    scene : Scene
    friction : Friction
        As it is now.
    contact : ContactState
    route : Route
        Of the base in the tick.
    share : float
        Of the tick that the step takes.
    dt : float
        Of the tick, s.
    jump : bool
        Whether the tissue's velocity jumps.
    """
    if not contact.inserted:
        return 1
    steps = half_spacings(share * route.length, scene.solver.track_spacing)
    return _unsteady(scene, friction, contact, route, share, dt, jump, steps)


def caught(before: ContactState, after: ContactState) -> bool:
    """Tell whether points of the track that slid along the needle stick to it after a step.

    What they move with there stops or starts at once: the tissue's velocity jumps, and the
    friction that holds them would alternate from step to step.
    """
    now = after.status[:-1].tobytes()
    if 0 not in now:
        return False
    return any(n == 0 != was for n, was in zip(now, before.status[:-1].tobytes(), strict=False))


def ends(contact: ContactState, way: float) -> tuple[float, ...]:
    """Return where to find the balance in a part of a tick, as shares of the part.

    At its end, and before where the tip is in the middle of a segment of the track.
    """
    share = contact.aiming(way) if contact.inserted else None
    return _AT_ITS_END if share is None else (share, 1.0)


class FreeOnTheWay:
    """Displacement without contact forces within a time step of the tissue.

    Between that at the step's start, which is what the forces of then leave of it, and the
    predicted one at its end.

    Parameters
    ----------
    predicted : callable
        At the end, as in Step.
    begun : ContactState
        At the start.
    """

    def __init__(self, predicted: FreeRows, begun: ContactState) -> None:
        self._predicted = predicted
        assert begun.track is not None
        self._start = begun.moved - begun.track.table.displacement(begun.forces)

    def at(self, share: float) -> FreeRows:
        """Return the displacement after a part of the step."""

        def free(table: ResponseTable) -> Vector:
            rows = self._predicted(table)
            known = min(len(self._start), len(rows))
            rows[:known] *= share
            rows[:known] += (1.0 - share) * self._start[:known]
            return rows

        return self._predicted if share == 1.0 else free
