# SPDX-License-Identifier: Apache-2.0
"""How far the tissue has given way within a time step.

Newmark's method knows the tissue at the ends of a time step; the contact is followed in parts of
it. While forces change evenly, so does the displacement between the step's ends. To anything
else the tissue yields as its viscosity lets it: beta u' + u = C f, solved exactly for forces that
change evenly from one part to the next. What changed evenly since the step's start meets all of
the step's compliance at its end. A settling half takes its last forces to have acted all along:
there those of a part act from its start.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from needle_sim_ros.geometry import Vector

# relaxation times
_BRIEF = 1e-5


class Yielded(NamedTuple):
    """How the tissue answers forces at an instant within a step.

    Attributes
    ----------
    share : float
        Of the step that has passed.
    part : float
        Of the step's compliance, that these forces meet.
    kept : ndarray, shape (k, d)
        Forces that stand for what it has yielded to besides, on the first rows, N.
    begun : ndarray, shape (k, d)
        Forces at the start of the step, N.
    """

    share: float
    part: float
    kept: Vector
    begun: Vector

    def acting(self, forces: Vector) -> Vector:
        """Return what acts, with the step's compliance, on the tissue on its way, (n, d), N.

        On its way it is from where it is at the start to where no forces would leave it.
        """
        rest = _added(self.part * forces, self.kept)
        return _added(rest, (self.share - 1.0) * self.begun)


class Yielding:
    """What the tissue yields to from part to part of a time step.

    Parameters
    ----------
    viscosity : float
        beta of the damping C = alpha M + beta K, s; without it the tissue yields at once.
    duration : float
        Of the step, s.
    begun, onward : ndarray, shape (k, d)
        Forces at its start, and at its end if they went on evenly, N.
    settling : bool
        Whether it is a settling half.
    """

    def __init__(
        self, viscosity: float, duration: float, begun: Vector, onward: Vector, settling: bool
    ) -> None:
        self._pace = duration / viscosity if viscosity > 0 else math.inf
        self._settling = settling
        self._whole = self._passed(self._pace)[-1]
        self._begun, self._rise, self._share = begun, onward - begun, 0.0
        self._changed = self._yielded = np.zeros_like(begun)

    def to(self, share: float) -> Yielded:
        """Return how it answers at the end of a part, after a share of the step."""
        left, old, new = self._since(share)
        kept = left * self._yielded + old * self._changed
        even = self._begun + share * self._rise
        return Yielded(share, new, _added(kept, (1.0 - new) * even), self._begun)

    def took(self, share: float, forces: Vector) -> None:
        """Go on from the end of that part, with forces (n, d) on the rows, N."""
        left, old, new = self._since(share)
        changed = _added(forces.copy(), -(self._begun + share * self._rise))
        yielded = _added(new * changed, left * self._yielded + old * self._changed)
        self._share, self._changed, self._yielded = share, changed, yielded

    def _since(self, share: float) -> tuple[float, float, float]:
        """Return what is left of what it yielded to, and what it does to old and new forces."""
        left, old, new = self._passed((share - self._share) * self._pace)
        return left, old / self._whole, new / self._whole

    def _passed(self, times: float) -> tuple[float, float, float]:
        """Return the same after so many relaxation times, of the static compliance."""
        left, gone = math.exp(-times), -math.expm1(-times)
        if self._settling:
            return left, 0.0, gone
        if times < _BRIEF:  # the differences below would be of rounding
            return left, times * (0.5 - times / 3.0), times * (0.5 - times / 6.0)
        return left, gone / times - left, 1.0 - gone / times


def _added(rows: Vector, more: Vector) -> Vector:
    """Add to rows, in place, those of others that there are."""
    known = min(len(rows), len(more))
    rows[:known] += more[:known]
    return rows
