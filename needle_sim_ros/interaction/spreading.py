# SPDX-License-Identifier: Apache-2.0
"""How lengths and the tip force are shared out over the track points."""

from __future__ import annotations

import numpy as np

from needle_sim_ros.geometry import Vector

# inserted length, in track spacings, below which a point carries nothing yet
LEAST = 1e-6


def coverage(depth: float, count: int, spacing: float) -> Vector:
    """Return the inserted length that each track point carries, shape (count,), m.

    The integral of hat k from the entry to `depth`: it grows smoothly as the tip passes,
    and all of them add up to `depth` once the last hat is reached.
    """
    length = np.empty(count)
    length.fill(spacing)
    first, one, two = _ends(depth / spacing, count)
    length[first] = spacing * one
    if first + 1 < count:
        length[first + 1] = spacing * two
        if first + 2 < count:
            length[first + 2 :] = 0.0
    # the entry has no hat above the surface
    length[0] = max((one if first == 0 else 1.0) * spacing - spacing * 0.5, 0.0)
    return length


def _ends(passed: float, count: int) -> tuple[int, float, float]:
    """Return the first of the two points about a depth, and what part of each hat is passed."""
    first = min(max(int(passed), 0), count - 1)
    t = min(passed - first, 1.0)
    one = 0.5 * (1 + t) ** 2 if t < 0 else 1 - 0.5 * (1 - t) ** 2
    t = min(passed - first - 1, 1.0)
    return first, one, 0.5 * (1 + t) ** 2 if t < 0 else 1 - 0.5 * (1 - t) ** 2


def tip_share(length: Vector, depth: float, spread: float, spacing: float) -> Vector:
    """Return how the tip force is spread over the last bevel length of the track.

    Parameters
    ----------
    length : ndarray, shape (n,)
        Inserted length that each point carries, m.
    depth, spread, spacing : float
        Depth of the tip, bevel length, track spacing, m.
    """
    share, first = length.copy(), 0
    if depth > spread:
        first, one, two = _ends((depth - spread) / spacing, len(length))
        share[:first] = 0.0
        share[first] -= spacing * (one if first else max(one - 0.5, 0.0))
        if first + 1 < len(length):
            share[first + 1] -= spacing * two
    total = sum(share[first:].tolist())
    if total <= LEAST * spacing:
        share.fill(0.0)
        share[0] = 1.0
        return share
    share /= total
    return share
