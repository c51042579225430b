# SPDX-License-Identifier: Apache-2.0
"""What the forces between needle and tissue add up to, for deflection, force and torque."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needle_sim_ros import compiled
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState

try:
    from needle_sim_ros.interaction import _resultants
except ImportError:  # built without a compiler, or run from the source
    _resultants = None  # type: ignore[assignment]

_COMPILED = _resultants is not None and compiled.wanted()
_EACH = 5  # numbers of a lateral axis


class Resultants(NamedTuple):
    """Sums over the forces on the tissue.

    Attributes
    ----------
    moments : list of (float, float, float, float)
        Sums of q, q s, q s^2 and q s^3 along each lateral axis, N to N m^3.
    rubbing : list of float
        Sum of the friction of the held points times the deflection there, N m.
    friction : float
        Sum of the axial friction, N.
    beyond : float
        Of it, that of points that the tip has only begun to pass, N.
    twist : float
        Torque about the axis of the base, N m; 0 in 2D.
    """

    moments: list[tuple[float, ...]]
    rubbing: list[float]
    friction: float
    beyond: float
    twist: float


def resultants(contact: ContactState, pose: BasePose) -> Resultants:
    """Add up the forces of a contact.

    Where the track holds the needle, it lies on the track, but for the softness of the hold.
    A tip that only touches the surface is bent along its lateral force: it neither rubs nor
    twists.
    """
    track, m = contact.track, len(pose.lateral)
    if track is None or contact.touching:
        moments = [tuple(row) for row in _moments(contact).tolist()]
        return Resultants(moments, [0.0] * m, float(contact.friction.sum()), 0.0, 0.0)
    if not _COMPILED:
        return _added_up(contact, pose, track.points)
    arrays = (contact.arclength, contact.lateral, contact.friction, contact.softness)
    *sums, friction, beyond, twist = _resultants.resultants(
        *[np.ascontiguousarray(each) for each in arrays],
        track.points,
        np.ascontiguousarray(contact.moved),
        pose.lateral,
        pose.origin,
    )
    each = [sums[_EACH * a : _EACH * (a + 1)] for a in range(m)]
    moments = [tuple(own[:-1]) for own in each]
    return Resultants(moments, [own[-1] for own in each], friction, beyond, twist)


def _moments(contact: ContactState) -> Vector:
    return np.asarray(contact.lateral @ np.vander(contact.arclength, 4, increasing=True))


def _added_up(contact: ContactState, pose: BasePose, points: Vector) -> Resultants:
    held, lateral, friction = len(contact.arclength), contact.lateral, contact.friction
    bent = pose.aside(points[:held] + contact.moved[:held]).T + contact.softness * lateral
    rubbing = bent[:, : len(friction)] @ friction[:held]
    twist = float(bent[1] @ lateral[0] - bent[0] @ lateral[1]) if len(lateral) == 2 else 0.0
    return Resultants(
        [tuple(row) for row in _moments(contact).tolist()],
        rubbing.tolist(),
        float(friction.sum()),
        float(friction[held:].sum()),
        twist,
    )
