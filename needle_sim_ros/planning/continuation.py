# SPDX-License-Identifier: Apache-2.0
"""Planning on from where the base is: what a node or a controller asks while it runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import (
    Vector,
    conjugate,
    from_rotation_vector,
    multiply,
    rotation_matrix,
    to_rotation_vector,
)
from needle_sim_ros.planning.quick import MaterialPoint, QuickSimulator
from needle_sim_ros.planning.rollout import Outcome, roll_on
from needle_sim_ros.planning.secant import SecantJacobian

_MOST_OFFSET = 15e-3  # m, sideways motion of the base
_ROLL_UNIT = 0.2  # rad that count as a millimetre of offset
_MOST_ROLLOUTS = 15
_CONTENT = 1e-5  # m
# how densely a way is told, m
_SPACING = 1e-3
# ... and how far turned, rad
_TURNED = 0.05


@dataclass(frozen=True)
class Pose:
    """The base at an instant: time s, position (3,) m, orientation (4,) x y z w."""

    time: float
    position: tuple[float, ...]
    orientation: tuple[float, ...]


@dataclass(frozen=True)
class Continuation:
    """On along the needle from a pose of the base, led sideways, the bevel turned first.

    Attributes
    ----------
    length, speed : float
        Of the needle, m; of the base, m/s.
    position, orientation : tuple
        Of the base at travel 0.
    offset : tuple of 2 floats
        Sideways motion along base x and y over `reference` of travel, m.
    reference, travel : float
        m.
    roll : float
        Turn about the needle's axis, made with the first step, rad.
    """

    length: float
    speed: float
    position: tuple[float, ...]
    orientation: tuple[float, ...]
    offset: tuple[float, float] = (0.0, 0.0)
    reference: float = 0.02
    travel: float = 0.0
    roll: float = 0.0
    turn: float = 0.0
    turn_at: float = 0.0
    turn_time: float = 0.0

    @property
    def axis(self) -> Vector:
        """Unit vector along the needle, (3,)."""
        return np.asarray(rotation_matrix(self.orientation)[:, 2])

    def place(self, travel: float) -> Vector:
        """Return the base position, (3,), m."""
        turned = rotation_matrix(self.orientation)
        aside = turned[:, 0] * self.offset[0] + turned[:, 1] * self.offset[1]
        share = min(travel / self.reference, 1.0)
        return np.asarray(np.array(self.position) + travel * turned[:, 2] + share * aside)

    def facing(self) -> Vector:
        """Return the base orientation, quaternion (4,)."""
        if self.roll == 0.0:
            return np.array(self.orientation)
        turned = multiply(self.orientation, from_rotation_vector([0.0, 0.0, self.roll]))
        return np.asarray(turned / np.linalg.norm(turned))

    def command(self, travel: float) -> BaseCommand:
        """Return the pose of the base at a travel."""
        return BaseCommand(position=self.place(travel), orientation=self.facing())

    def poses(self) -> list[Pose]:
        """Return the way as poses, the first where the base is."""
        count = max(1, round(abs(self.travel) / _SPACING))
        start = Pose(0.0, self.position, self.orientation)
        facing = tuple(self.facing().tolist())
        return [start] + [
            Pose(abs(t) / self.speed, tuple(self.place(t).tolist()), facing)
            for t in np.linspace(0.0, self.travel, count + 1)[1:].tolist()
        ]


def follow(simulator: QuickSimulator, poses: Sequence[Pose]) -> Vector:
    """Lead a simulator through poses from its state; return the tip after each, (n, 3), m."""
    tips = np.empty((len(poses), 3))
    time = poses[0].time if poses else 0.0
    for index, pose in enumerate(poses):
        duration = max(pose.time - time, 1e-6)
        command = BaseCommand(position=pose.position, orientation=pose.orientation)
        tips[index] = simulator.step(command, duration).tip_position
        time = pose.time
    return tips


class Way:
    """The way of a base so far, kept as few poses.

    Parameters
    ----------
    start : Pose
    spacing : float
        Between poses kept, m.
    """

    def __init__(self, start: Pose, spacing: float) -> None:
        self._spacing = spacing
        self._kept = [start]

    @property
    def poses(self) -> tuple[Pose, ...]:
        """From the start to the latest."""
        return tuple(self._kept)

    @property
    def latest(self) -> Pose:
        """Where the base was last seen."""
        return self._kept[-1]

    def add(self, here: Pose) -> None:
        """Note where the base is; of a stand only its first and last instant are kept."""
        last = self._kept[-1]
        if here.time <= last.time:
            return
        before = self._kept[-2] if len(self._kept) > 1 else None
        stands = _same(here, last)
        stood = before is not None and _same(before, last)
        if before is None or stands != stood or (not stands and self._far(here, before)):
            self._kept.append(here)
        else:
            self._kept[-1] = here

    def _far(self, here: Pose, before: Pose) -> bool:
        turned = multiply(here.orientation, conjugate(before.orientation))
        return (
            math.dist(here.position, before.position) >= self._spacing
            or float(np.linalg.norm(to_rotation_vector(turned))) >= _TURNED
        )


def _same(a: Pose, b: Pose) -> bool:
    return a.position == b.position and a.orientation == b.orientation


def steer(
    simulator: QuickSimulator,
    target: MaterialPoint,
    speed: float,
    bias: Vector | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
) -> tuple[Continuation, Outcome]:
    """Find how to go on so that the tip arrives at a target; the state is left as it was.

    In 2D the base moves sideways; in 3D it does so both ways and turns the bevel.

    Parameters
    ----------
    simulator : QuickSimulator
        In the state to go on from.
    target : MaterialPoint
    speed : float
        Of the base, m/s.
    bias : ndarray, shape (3,), optional
        How much farther from the target the tip is seen than the model has it, m.
    offset : tuple of 2 floats
        Sideways motion to begin the search with, m.

    Raises
    ------
    NeedleSimError
        When not even the way straight on can be rolled out.
    """
    start, seen = simulator.snapshot(), simulator.observe()
    extra = np.zeros(3) if bias is None else np.asarray(bias, dtype=float)
    seen_at = MaterialPoint(target.place - extra, target.response)
    position = tuple(seen.base_position.tolist())
    orientation = tuple(seen.base_orientation.tolist())
    left = simulator.position_of(seen_at) - seen.tip_position
    straight = Continuation(simulator.scene.needle.length, speed, position, orientation)
    depth = float(left @ straight.axis)
    straight = replace(straight, reference=max(depth, 1e-3), offset=offset)
    lateral = simulator.scene.dimension - 1
    best: list[tuple[Continuation, Outcome]] = []

    def tried(x: Vector) -> Vector:
        pair = (1e-3 * float(x[0]), 1e-3 * float(x[1]) if lateral == 2 else 0.0)
        roll = _ROLL_UNIT * float(x[2]) if lateral == 2 else 0.0
        motion = replace(straight, offset=pair, roll=roll)
        simulator.restore(start)
        outcome = roll_on(simulator, motion, seen_at, arrive=True)
        if not outcome.stopped and (not best or outcome.miss < best[0][1].miss):
            best[:] = [(replace(motion, travel=outcome.travel), outcome)]
        if outcome.miss <= _CONTENT and not outcome.stopped:
            raise StopIteration
        return 1e3 * outcome.gap

    most = np.full(1 if lateral == 1 else 3, 1e3 * _MOST_OFFSET)
    first = np.zeros(len(most))
    first[:lateral] = 1e3 * np.array(offset[:lateral])
    jacobian = SecantJacobian(tried, np.full(len(most), 0.2))
    try:
        if depth > 1e-3:
            least_squares(
                jacobian.function,
                np.clip(first, -most, most),
                jac=jacobian,
                bounds=(-most, most),
                xtol=1e-4,
                ftol=1e-5,
                max_nfev=_MOST_ROLLOUTS,
            )
        else:
            tried(first)
    except StopIteration:
        pass
    finally:
        simulator.restore(start)
    if not best:
        raise NeedleSimError("no way on from here: every candidate leaves the model")
    return best[0]
