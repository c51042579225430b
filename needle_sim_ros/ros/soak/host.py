# SPDX-License-Identifier: Apache-2.0
"""What the host of a virtual machine withheld, and how the node did while it withheld nothing."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

_STOLEN = 8  # number of the word in the first line of /proc/stat


def stolen_time() -> float:
    """Return how long all processors together stood still for others since the start, s.

    In hundredths of a second; 0 on a machine of its own, and where the system does not say.
    """
    try:
        words = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        return int(words[_STOLEN]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0


@dataclass(frozen=True)
class Reading:
    """Ticks, overruns and stolen time since the start, at one time; s."""

    time: float
    ticks: int
    overruns: int
    stolen: float


@dataclass(frozen=True)
class Undisturbed:
    """How the node did.

    Attributes
    ----------
    stolen : float
        Part of all processors' time that the host gave to others.
    seconds : float
        How long the stretches between two readings were in which it gave none.
    overruns : float or None
        Part of the deadlines missed in these; None where there are none.
    """

    stolen: float = 0.0
    seconds: float = 0.0
    overruns: float | None = None


def undisturbed(readings: Sequence[Reading]) -> Undisturbed:
    """Return what readings, in their order, say."""
    ticks = overruns = 0
    seconds = 0.0
    for one, other in pairwise(readings):
        if other.stolen == one.stolen:
            ticks += other.ticks - one.ticks
            overruns += other.overruns - one.overruns
            seconds += other.time - one.time
    length = (readings[-1].time - readings[0].time) * (os.cpu_count() or 1) if readings else 0.0
    stolen = (readings[-1].stolen - readings[0].stolen) / length if length else 0.0
    due = ticks + overruns
    return Undisturbed(stolen, seconds, overruns / due if due else None)
