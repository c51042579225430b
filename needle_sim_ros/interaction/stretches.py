# SPDX-License-Identifier: Apache-2.0
"""Stretches of the track with one set of limits, and what the tip bears where they meet.

A region with a puncture force of its own has a membrane, which breaks as the surface does.
The tip waits at a tissue that is harder to cut; what it bore before falls within a bevel length,
so that no force jumps.
"""

from __future__ import annotations

from typing import NamedTuple

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.laws import Laws, LocalLaws

# places on a piece of track that are looked at, and halvings between two that differ
_LOOKS, _HALVINGS = 4, 20


class Stretch(NamedTuple):
    """Limits from a depth on, and whether a membrane has to be broken there."""

    depth: float
    limits: LocalLaws
    membrane: bool


def first(laws: Laws, entry: Vector) -> tuple[Stretch, ...]:
    """Return the stretch that begins at the surface."""
    return (Stretch(0.0, laws.at(entry), True),)


def onward(
    known: tuple[Stretch, ...],
    laws: Laws,
    start: float,
    point: Vector,
    piece: Vector,
    length: float,
) -> tuple[Stretch, ...]:
    """Return the stretches with those that begin on another piece of track.

    Parameters
    ----------
    known : tuple of Stretch
    laws : Laws
    start : float
        Depth of the piece's start, m.
    point : ndarray, shape (d,)
        Its start, m.
    piece : ndarray, shape (d,)
        From there to its end.
    length : float
        Its length along the track, m.
    """
    if not laws.vary:
        return known
    here, low = known[-1].limits, 0.0
    for look in range(1, _LOOKS + 1):
        high = look / _LOOKS
        there = laws.at(point + high * piece)
        if there != here:
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                if laws.at(point + middle * piece) == here:
                    low = middle
                else:
                    high = middle
            membrane = there.membrane >= 0 and there.membrane != here.membrane
            known = (*known, Stretch(start + high * length, there, membrane))
            here = there
        low = look / _LOOKS
    return known


def tip_bound(stretches: tuple[Stretch, ...], front: float, bevel: float) -> tuple[float, float]:
    """Return the cutting force of a tip at a depth, and what opening adds to it, N.

    What a tip bore to get through a membrane, or in the tissue before, falls to the cutting
    force while the bevel passes. A tissue that takes more stops the tip until it bears that.
    """
    excess, here = 0.0, stretches[0]
    for stretch in stretches:
        if stretch.depth > front:
            break
        before = here.limits.cutting + excess * _left(stretch.depth - here.depth, bevel)
        needed = max(before, stretch.limits.puncture) if stretch.membrane else before
        excess, here = max(0.0, needed - stretch.limits.cutting), stretch
    return here.limits.cutting, excess * _left(front - here.depth, bevel)


def _left(way: float, bevel: float) -> float:
    return max(0.0, 1.0 - way / bevel)
