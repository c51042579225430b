# SPDX-License-Identifier: Apache-2.0
"""Collects garbage in pieces that fit between two ticks.

A collection holds the interpreter from its beginning to its end, and a full one looks at
everything that lives: some milliseconds, several ticks at 1 kHz. Of what was made since the
last second little lives, and what refers to itself in a circle mostly dies young.
"""

from __future__ import annotations

import gc
from collections.abc import Callable

# s between collections of the youngest, the middle and all generations
PERIOD = 0.1
_MIDDLE, _ALL = 10.0, 600.0
_ROOM = 5e-4  # s, which the first two take at most where a node records at 1 kHz


class Garbage:
    """Takes over from Python's own collections, where these are switched off.

    Parameters
    ----------
    give_way : callable
        Given how long the work takes, s; waits until there is room for it.
    """

    def __init__(self, give_way: Callable[[float], object]) -> None:
        self._give_way = give_way
        self._calls = 0

    def collect(self, pause: Callable[[], object] = lambda: None) -> None:
        """Collect what is due; to be called every `PERIOD`. There are no pieces to pause at."""
        if gc.isenabled():
            return
        self._calls += 1
        generation = 0
        if self._calls % round(_ALL / PERIOD) == 0:
            generation = 2
        elif self._calls % round(_MIDDLE / PERIOD) == 0:
            generation = 1
        self._give_way(_ROOM)
        gc.collect(generation)
