# SPDX-License-Identifier: Apache-2.0
"""What sensors on a needle read: tip, force and torque, from the forces along it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needle_sim_ros import compiled
from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.state import ContactState

try:
    from needle_sim_ros.interaction import _readings
except ImportError:  # built without a compiler, or run from the source
    _readings = None  # type: ignore[assignment]

_COMPILED = _readings is not None and compiled.wanted()


class Readings(NamedTuple):
    """Of a needle at an instant; as tuples, of which messages are made.

    Attributes
    ----------
    tip_deflection : tuple of 3 floats
        From the undeflected needle, base frame, z = 0, m.
    tip_slope : tuple of 2 floats
        Of the deflected needle at the tip, along base x and y.
    tip_position : tuple of 3 floats
        Tissue frame, m.
    base_force : tuple of 3 floats
        What the tissue does to the needle, base frame, N.
    base_torque : tuple of 3 floats
        The same about the base, N m.
    friction_force : float
        Sum of the axial friction on the tissue, N.
    """

    tip_deflection: tuple[float, ...]
    tip_slope: tuple[float, ...]
    tip_position: tuple[float, ...]
    base_force: tuple[float, ...]
    base_torque: tuple[float, ...]
    friction_force: float


def readings(contact: ContactState, pose: BasePose, length: float, rigidity: float) -> Readings:
    """Return what the forces of a contact do to the needle.

    Where the track holds the needle, it lies on the track, but for the softness of the hold.
    A tip that only touches the surface is bent along its lateral force: it neither rubs nor
    twists.

    Parameters
    ----------
    contact : ContactState
    pose : BasePose
    length : float
        Of the needle, m.
    rigidity : float
        Its flexural rigidity, N m^2.
    """
    track = contact.track
    if track is None or contact.touching or not _COMPILED:
        return _by_numpy(contact, pose, length, rigidity)
    arrays = (
        contact.arclength,
        contact.lateral,
        contact.friction,
        contact.softness,
        track.points,
        contact.moved,
    )
    others = (pose.lateral, pose.origin, pose.axial, contact.tip, length, rigidity)
    try:
        found = _readings.readings(*arrays, *others)
    except (ValueError, BufferError):  # strided, which a tick's own arrays are not
        found = _readings.readings(*[np.ascontiguousarray(each) for each in arrays], *others)
    return Readings._make(found)


def _by_numpy(contact: ContactState, pose: BasePose, length: float, rigidity: float) -> Readings:
    held, lateral, friction = len(contact.arclength), contact.lateral, contact.friction
    total, turn, square, cube = (lateral @ np.vander(contact.arclength, 4, increasing=True)).T
    # all forces act between clamp and tip: a = s_k, b = L in the flexibility
    bent = -(3.0 * length * square - cube) / (6.0 * rigidity)
    # r x F with r = (lateral, s) and F = (-q, -f): moments of both about x and y;
    # friction on what is ahead of the tip acts at the tip
    moment, twist, ahead = -turn, 0.0, 0.0
    if contact.track is not None and not contact.touching:
        points = contact.track.points[:held] + contact.moved[:held]
        each = pose.aside(points).T + contact.softness * lateral
        moment = moment + each[:, : len(friction)] @ friction[:held]
        ahead = float(friction[held:].sum())
        if len(lateral) == 2:
            twist = float(each[1] @ lateral[0] - each[0] @ lateral[1])
    if contact.active:
        moment = moment + bent * (ahead + contact.tip)
    rubbing = float(friction.sum())
    place = pose.origin + length * pose.axial + bent @ pose.lateral
    plane = len(bent) == 1
    return Readings(
        (*_padded(bent), 0.0),
        _padded(-square / (2.0 * rigidity)),
        (float(place[0]), 0.0 if plane else float(place[1]), float(place[-1])),
        (*_padded(-total), -(rubbing + contact.tip)),
        (0.0 if plane else -float(moment[1]), float(moment[0]), twist),
        rubbing,
    )


def _padded(lateral: Vector) -> tuple[float, ...]:
    """Return components along base x and y."""
    return (float(lateral[0]), float(lateral[1]) if len(lateral) == 2 else 0.0)
