# SPDX-License-Identifier: Apache-2.0
"""A tick in parts: how finely the contact follows the base's way, and the tissue gives way.

The tissue moves on once in a time step of Newmark's method; the contact may find its balance
more often, so that track and friction do not hang on how far the base goes in a step.
"""

from __future__ import annotations

import math

from needle_sim_ros.interaction.contact import Contact
from needle_sim_ros.interaction.friction import creep
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.scene import Friction, Scene
from needle_sim_ros.tick.base_motion import BaseMotion
from needle_sim_ros.tick.route import Route

# rad that the base turns at most in a step of a tick
_TURN = 0.05
# path in a part, in weakening distances, where points begin to slide
_FINE = 0.06
# time in a part, in healing times, where points may be stuck
_HEALED = 0.1
# time in a part, in the time in which tissue yields, where the surface has just broken
_SPRUNG = 0.25
# most parts for any of these
MOST = 32
# slip that counts no more, in weakening distances
_HEALED_OFF = 1e-3
_AT_ITS_END = (1.0,)


class Division:
    """Tells into how many parts ticks and time steps fall.

    Parameters
    ----------
    scene : Scene
    laws : Contact
        Whose laws of the moment count.
    """

    def __init__(self, scene: Scene, laws: Contact) -> None:
        self._laws, self._spacing = laws, scene.solver.track_spacing
        self._length, self._viscosity = scene.needle.length, scene.tissue.damping.beta

    def of_tick(self, contact: ContactState, route: Route, jump: bool) -> int:
        """Return into how many equal parts a quasi-static tick falls.

        Parameters
        ----------
        contact : ContactState
        route : Route
            Of the base in the tick.
        jump : bool
            Whether the velocity of base or tissue jumps.
        """
        motion = route.motion
        if not (contact.inserted or contact.touching) and motion.rate[2] > 0:
            return 1
        parts = static_parts(motion, self._spacing)
        return self._unsteady(contact, route, 1.0, jump, parts) if contact.inserted else parts

    def of_step(self, contact: ContactState, route: Route, share: float, jump: bool) -> int:
        """Return in how many equal parts the contact follows a time step of Newmark's method.

        Parameters
        ----------
        contact : ContactState
        route : Route
            Of the base in the tick.
        share : float
            Of the tick that the step takes.
        jump : bool
            Whether the tissue's velocity jumps.
        """
        if not contact.inserted:
            return 1
        parts = half_spacings(share * route.length, self._spacing)
        return self._unsteady(contact, route, share, jump, parts)

    def of_opening(self, route: Route, share: float) -> int:
        """Return the same of what is left of a time step in which the surface breaks.

        There the tissue springs back as fast as its viscosity lets it.
        """
        parts = half_spacings(share * route.length, self._spacing)
        if self._viscosity == 0:
            return parts
        yields = math.ceil(share * route.duration / (_SPRUNG * self._viscosity))
        return max(parts, min(MOST, yields))

    def _unsteady(
        self, contact: ContactState, route: Route, share: float, jump: bool, parts: int
    ) -> int:
        """Return into how many parts the time falls in which friction changes, or as many."""
        friction = self._laws.laws.interaction.friction
        fastest = route.fastest(self._length)
        finer = unsteady_parts(fastest, share * route.duration, friction, parts)
        if finer == parts or jump or not contact.status[:-1].all():
            return finer
        whole, slip = friction.weakening_distance, contact.slip
        heals = slip > _HEALED_OFF * whole
        if abs(route.advance) > creep(friction) * route.duration:
            heals &= slip < whole
        return finer if heals.any() else parts


def half_spacings(way: float, spacing: float) -> int:
    """Return into how many parts of half a track spacing a way falls, both m."""
    return max(1, math.ceil(2 * way / spacing - 1e-9))


def static_parts(motion: BaseMotion, spacing: float) -> int:
    """Return into how many parts of half a track spacing, m, a quasi-static tick falls."""
    return max(half_spacings(motion.length, spacing), math.ceil(motion.angle / _TURN))


def unsteady_parts(speed: float, dt: float, friction: Friction, least: int) -> int:
    """Return into how many parts a tick falls in which points begin to slide.

    Where each of them does is known to a part only, and what follows depends on it; so it does
    on how far the friction of those that are stuck has recovered.

    Parameters
    ----------
    speed : float
        Of the base, m/s.
    dt : float
        s.
    friction : Friction
    least : int
        Parts that it falls into anyway.
    """
    slid = speed * dt / (_FINE * friction.weakening_distance)
    healed = dt / (_HEALED * friction.healing_time)
    return max(least, min(MOST, math.ceil(max(slid, healed) - 1e-9)))


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
