# SPDX-License-Identifier: Apache-2.0
"""What one tick was told, kept exactly: the arguments of its base command.

`BaseCommand` normalises its quaternion; doing so twice can change the last bit. A
session therefore keeps the numbers that went in, and a replay builds the same command
from them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.command import BaseCommand

Numbers = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Motion:
    """A pose to reach at the end of the tick, or a velocity held for it.

    Parameters
    ----------
    kind : {"pose", "velocity"}
        What the numbers mean.
    linear : tuple of 3, or None
        Position, m, or velocity, m/s; tissue frame.
    angular : tuple, or None
        Quaternion x y z w, or angular velocity, rad/s.
    """

    kind: Literal["pose", "velocity"]
    linear: Numbers | None
    angular: Numbers | None
    _command: BaseCommand | None = field(default=None, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, command: BaseCommand) -> Motion:
        """Return the motion of a command made elsewhere."""
        if command.position is not None or command.orientation is not None:
            return cls("pose", _numbers(command.position), _numbers(command.orientation))
        return cls("velocity", _numbers(command.velocity), _numbers(command.angular_velocity))

    @classmethod
    def from_values(cls, kind: Literal["pose", "velocity"], values: Sequence[float]) -> Motion:
        """Return the motion whose :meth:`values` these are."""
        return cls(kind, _given(values[:3]), _given(values[3:]))

    def values(self) -> Numbers:
        """Return linear and angular numbers in one row, NaN where nothing was given."""
        width = 4 if self.kind == "pose" else 3
        return (self.linear or (math.nan,) * 3) + (self.angular or (math.nan,) * width)

    def command(self) -> BaseCommand:
        """Return the base command, always the same."""
        command = self._command
        if command is None:
            if self.kind == "pose":
                command = BaseCommand(position=self.linear, orientation=self.angular)
            else:
                command = BaseCommand(velocity=self.linear, angular_velocity=self.angular)
            object.__setattr__(self, "_command", command)
        return command


STILL = Motion("velocity", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _numbers(array: NDArray[np.float64] | None) -> Numbers | None:
    return None if array is None else tuple(array.tolist())


def _given(values: Sequence[float]) -> Numbers | None:
    return None if any(math.isnan(value) for value in values) else tuple(values)
