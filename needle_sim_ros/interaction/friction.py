# SPDX-License-Identifier: Apache-2.0
"""Friction along the needle: its limits in a step, and the slip that it remembers.

Static friction falls to kinetic as a point slips (segments DE and FG of Fig. 3) and comes back
as it rests. What is remembered changes as far as the point moves and as long as it rests, never
at once: an event that lasts but an instant must not leave a mark, or what follows would hang on
how finely time is divided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.geometry import Vector
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.interaction.track import Track
from needle_sim_ros.scene import Friction

# advances up to this, m, count as a hold
STILL = 1e-12
# weakening distances per healing time: a point that slides as fast heals half as fast as at rest
_CREEP = 1e-3


class FrictionMemory(NamedTuple):
    """What friction remembers of a step; members as in ContactState.

    Attributes
    ----------
    slip, strain, slid : ndarray, shape (active,)
        Slip that counts, elastic presliding, slip in the step, m.
    advance : float
        Of the needle in the step, m.
    lasted : float
        Duration of the step, s.
    """

    slip: Vector
    strain: Vector
    slid: Vector
    advance: float
    lasted: float

    def pace(self, advance: float) -> float:
        """Return an advance in proportion to the one remembered; 0 where it is another way."""
        return advance / self.advance if advance * self.advance > 0 else 0.0

    def lapse(self, duration: float) -> float:
        """Return a duration in proportion to the one remembered."""
        return duration / self.lasted if self.lasted > 0 else 1.0


class FrictionStart(NamedTuple):
    """What the points along the needle bring into a step.

    Attributes
    ----------
    static, kinetic : ndarray, shape (n,)
        Limits at the points, N/m.
    slip : ndarray, shape (n,)
        What has not healed of it, m; static friction where it is 0, kinetic from the weakening
        distance on.
    strain : ndarray, shape (n,)
        Elastic presliding, m.
    status : ndarray of int8, shape (n,)
        Bounds that hold, as guessed.
    advance : float
        Of the needle in the step, m.
    slid : ndarray, shape (n,)
        In the step before, m.
    pace, lapse : float
        Advance and duration of this step, in proportion to the one before.
    duration : float
        Of this step, s.
    """

    static: Vector
    kinetic: Vector
    slip: Vector
    strain: Vector
    status: NDArray[np.int8]
    advance: float
    slid: Vector
    pace: float
    lapse: float
    duration: float

    @property
    def onward(self) -> Vector:
        """Slip to be expected in the step where a point goes on as it did, m, shape (n,).

        What the needle drags along goes on as it does, all else as time passes.
        """
        return self.slid * np.where(self.status * self.advance > 0, self.pace, self.lapse)

    @classmethod
    def of(
        cls,
        track: Track,
        memory: FrictionMemory,
        status: NDArray[np.int8],
        advance: float,
        duration: float,
    ) -> FrictionStart:
        """Fit what was before to a step; `status` has one entry more, the tip's."""
        n = len(status) - 1
        slip, strain, slid = (fitted(values, n) for values in memory[:3])
        pace, lapse = memory.pace(advance), memory.lapse(duration)
        static, kinetic = track.static[:n], track.kinetic[:n]
        bounds = status[:-1]
        return cls(static, kinetic, slip, strain, bounds, advance, slid, pace, lapse, duration)


def limits(laws: Laws, start: FrictionStart) -> Vector:
    """Return the friction limits of a step per length, either way, N/m, shape (n,).

    What slides goes on sliding as fast against the needle as it did, what sticks rests.
    """
    slip = slip_after(laws, start.slip, start.status, start.onward, start.duration)
    return laws.friction(start.static, start.kinetic, slip)


def creep(friction: Friction) -> float:
    """Return the speed at which a point that slides heals half as fast as one at rest, m/s."""
    return _CREEP * friction.weakening_distance / friction.healing_time


def slip_after(
    laws: Laws, slip: Vector, status: NDArray[np.int8], slid: Vector, duration: float
) -> Vector:
    """Return the slip that counts after a step, m, shape (n,).

    It grows as a point slides, up to the weakening distance, and heals the faster, the slower.

    Parameters
    ----------
    laws : Laws
    slip : ndarray, shape (n,)
        That counts before, m.
    status : ndarray of int8, shape (n,)
        Bounds that hold.
    slid : ndarray, shape (n,)
        In the step, m.
    duration : float
        Of the step, s.
    """
    friction = laws.interaction.friction
    way = np.where(status != 0, np.abs(slid), 0.0)
    heals = duration / friction.healing_time / (1.0 + way / (creep(friction) * duration))
    left = slip * np.exp(-heals) - way * np.expm1(-heals) / heals
    return np.minimum(left, friction.weakening_distance)


def guess(status: NDArray[np.int8], n: int) -> NDArray[np.int8]:
    """Fit the bounds that held before to n friction forces and the tip."""
    if len(status) == n + 1:
        return status
    if len(status) == 0:
        return np.zeros(n + 1, dtype=np.int8)
    friction, tip = status[:-1], status[-1:]
    if len(friction) < n:
        last = friction[-1] if len(friction) else 0
        friction = np.append(friction, np.full(n - len(friction), last, dtype=np.int8))
    return np.concatenate([friction[:n], tip])


def fitted(values: Vector, n: int) -> Vector:
    """Cut or extend what was before to n entries: a new point slides as the last one does."""
    if len(values) >= n:
        return values[:n]
    wider = np.full(n, values[-1] if len(values) else 0.0)
    wider[: len(values)] = values
    return wider
