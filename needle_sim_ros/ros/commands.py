# SPDX-License-Identifier: Apache-2.0
"""What the stage makes of the commands it receives: refusals, timeout, speed limits.

Pure Python: the time is passed in, so that tests need neither ROS nor waiting.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from needle_sim_ros.geometry import with_finite_norm
from needle_sim_ros.session.motion import STILL, Motion

Numbers = Sequence[float]
_INSTANT = 1e-9  # s, below which two simulated times are the same
_SMALLEST_NORM = 1e-6


@dataclass(frozen=True)
class StageLimits:
    """What the stage can do and accepts.

    Parameters
    ----------
    speed : float
        Fastest motion of the base, m/s.
    angular_speed : float
        Fastest turn of the base, rad/s.
    jump : float
        Poses farther than this from where the base is are refused, m.
    timeout : float
        A command holds for this simulated time, s; 0 means until the next one.
    """

    speed: float
    angular_speed: float
    jump: float
    timeout: float


@dataclass(frozen=True)
class _Command:
    motion: Motion
    received: float


class StageCommands:
    """Takes commands as they come and says what each tick does; the newest wins.

    Commands may come from another thread than the ticks.

    Parameters
    ----------
    frame : str
        The only frame that commands may be in; an empty frame id counts as this one.
    limits : StageLimits
        May be replaced at any time.
    """

    def __init__(self, frame: str, limits: StageLimits) -> None:
        self.frame = frame
        self.limits = limits
        self.received = 0
        self.rejected: Counter[str] = Counter()
        self.timeouts = 0
        self._newest: _Command | None = None
        self._timed_out: _Command | None = None

    def pose(
        self, position: Numbers, orientation: Numbers, frame: str, now: float, here: Numbers
    ) -> str | None:
        """Take a pose to go to; return why it was refused, or None.

        Parameters
        ----------
        position : 3 numbers
            m, tissue frame.
        orientation : 4 numbers
            Quaternion x y z w, of any length but zero.
        frame : str
            Frame id of the message.
        now : float
            Simulated time, s.
        here : 3 numbers
            Where the base is, m.
        """
        orientation = with_finite_norm(orientation)
        norm = math.hypot(*orientation)
        reason = self._common(frame, (*position, *orientation))
        if reason is None and norm < _SMALLEST_NORM:
            reason = "zero quaternion"
        if reason is None and math.dist(position, here) > self.limits.jump:
            reason = f"jump of more than {self.limits.jump:g} m"
        if reason is not None:
            return self._refuse(reason)
        unit = tuple(q / norm for q in orientation)
        self._take(Motion("pose", tuple(position), unit), now)
        return None

    def velocity(self, linear: Numbers, angular: Numbers, frame: str, now: float) -> str | None:
        """Take a velocity, m/s and rad/s in the tissue frame; return why refused, or None."""
        reason = self._common(frame, (*linear, *angular))
        if reason is not None:
            return self._refuse(reason)
        self._take(Motion("velocity", tuple(linear), tuple(angular)), now)
        return None

    def unreadable(self) -> str:
        """Count bytes that are no message; return why they were refused."""
        return self._refuse("unreadable")

    def refuse_current(self, reason: str) -> None:
        """Forget the command in force: the simulator refused it."""
        self.rejected[reason] += 1
        self._newest = None

    def clear(self) -> None:
        """Forget the command in force: the simulation starts over."""
        self._newest = None

    @property
    def rejected_count(self) -> int:
        """Commands refused for any reason."""
        return sum(tuple(self.rejected.values()))

    @property
    def timed_out(self) -> bool:
        """Whether the stage stands still because its command is too old."""
        return self._newest is not None and self._newest is self._timed_out

    def age(self, now: float) -> float | None:
        """Return the age of the newest command, s of simulated time; None without one."""
        newest = self._newest
        return None if newest is None else now - newest.received

    def motion(self, position: Numbers, orientation: Numbers, now: float, dt: float) -> Motion:
        """Return what the base does in the tick from `now` to `now + dt`.

        Parameters
        ----------
        position, orientation : 3 and 4 numbers
            The pose of the base now.
        now, dt : float
            s.
        """
        command, limits = self._newest, self.limits
        if command is None:
            return STILL
        if limits.timeout and now - command.received >= limits.timeout - _INSTANT:
            if command is not self._timed_out:
                self.timeouts += 1
                self._timed_out = command
            return STILL
        if command.motion.kind == "velocity":
            return _slowed(command.motion, limits)
        return _approach(command.motion, position, orientation, limits, dt)

    def _common(self, frame: str, numbers: Numbers) -> str | None:
        if frame not in ("", self.frame):
            return f"frame is not {self.frame}"
        if not all(map(math.isfinite, numbers)):
            return "not finite"
        return None

    def _refuse(self, reason: str) -> str:
        self.received += 1
        self.rejected[reason] += 1
        return reason

    def _take(self, motion: Motion, now: float) -> None:
        motion.command()  # made here, beside the ticks
        self._newest = _Command(motion, now)
        self.received += 1


def _slowed(motion: Motion, limits: StageLimits) -> Motion:
    """Scale a twist as a whole, so that it keeps its direction."""
    linear, angular = motion.linear or (), motion.angular or ()
    speed, turn = math.hypot(*linear), math.hypot(*angular)
    if speed <= limits.speed and turn <= limits.angular_speed:
        return motion
    factor = min(_ratio(limits.speed, speed), _ratio(limits.angular_speed, turn))
    return Motion("velocity", _scaled(linear, factor), _scaled(angular, factor))


def _approach(
    target: Motion, position: Numbers, orientation: Numbers, limits: StageLimits, dt: float
) -> Motion:
    """Go straight towards a pose and turn the short way, arriving with both at once."""
    goal, turned = target.linear or (), target.angular or ()
    cosine = sum(a * b for a, b in zip(orientation, turned, strict=True))
    nearest = turned if cosine >= 0 else tuple(-q for q in turned)
    chord = math.dist(orientation, nearest)
    half = 2 * math.asin(min(1.0, chord / 2))  # half the angle between the orientations
    fraction = min(
        _ratio(limits.speed * dt, math.dist(goal, position)),
        _ratio(limits.angular_speed * dt, 2 * half),
    )
    if fraction >= 1:
        return target
    there = tuple(p + fraction * (g - p) for p, g in zip(position, goal, strict=True))
    return Motion("pose", there, _slerp(orientation, nearest, half, fraction))


def _slerp(start: Numbers, end: Numbers, half: float, fraction: float) -> tuple[float, ...]:
    if half < 1e-9:
        return tuple(end)
    a = math.sin((1 - fraction) * half) / math.sin(half)
    b = math.sin(fraction * half) / math.sin(half)
    return tuple(a * p + b * q for p, q in zip(start, end, strict=True))


def _ratio(limit: float, value: float) -> float:
    return 1.0 if value <= limit else limit / value


def _scaled(numbers: Numbers, factor: float) -> tuple[float, ...]:
    return tuple(factor * number for number in numbers)
