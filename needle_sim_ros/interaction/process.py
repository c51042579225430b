# SPDX-License-Identifier: Apache-2.0
"""The four processes of an insertion (Fig. 2), read off the state."""

from __future__ import annotations

from enum import Enum


class Process(Enum):
    """What the needle is doing; FREE when it does not touch the tissue."""

    FREE = "free"
    CONTACT = "contact"
    INSERTION = "insertion"
    HOLD = "hold"
    RETRACTION = "retraction"


def classify(touching: bool, inserted: bool, advance: float, still: float = 1e-12) -> Process:
    """Return the process of a tick.

    Parameters
    ----------
    touching : bool
        The tip presses on the unbroken surface.
    inserted : bool
        The surface is broken and the tip is below it.
    advance : float
        How far the base moved along the needle in the tick, m.
    still : float
        Advances up to this, m, count as a hold.
    """
    if inserted:
        if advance > still:
            return Process.INSERTION
        return Process.RETRACTION if advance < -still else Process.HOLD
    return Process.CONTACT if touching else Process.FREE
