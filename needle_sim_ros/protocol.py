# SPDX-License-Identifier: Apache-2.0
"""A scene's protocol as one command per tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import SceneError
from needle_sim_ros.scene import Segment

_SLACK = 1e-9  # of a tick: what rounding may add to a boundary that falls on a tick's end
_MOST_TICKS = 10_000_000


def protocol_commands(protocol: Sequence[Segment], time_step: float) -> list[BaseCommand]:
    """Return the base command of each tick of a protocol.

    A tick that lies across the end of a segment gets the mean twist over the tick, so
    the stage ends each segment where the protocol says, whatever the tick.

    Parameters
    ----------
    protocol : sequence of Segment
        Followed from the first to the last.
    time_step : float
        Tick, s.

    Returns
    -------
    list of BaseCommand
        As many as it takes to cover the protocol; the last is padded with rest. Equal
        consecutive commands are the same object.

    Raises
    ------
    SceneError
        When the protocol is empty, or takes more than 10 million ticks.
    """
    if not protocol:
        raise SceneError("protocol", [], "empty: nothing to run")
    ends = np.cumsum([segment.duration for segment in protocol]) / time_step
    if ends[-1] > _MOST_TICKS:
        allowed = f"{ends[-1]:.3g} ticks of {time_step:g} s: at most {_MOST_TICKS}"
        raise SceneError("protocol", f"{ends[-1] * time_step:g} s", allowed)
    starts = np.concatenate([[0.0], ends[:-1]])
    twists = np.array([[*segment.velocity, *segment.angular_velocity] for segment in protocol])
    own = [segment.command() for segment in protocol]
    ticks = np.arange(max(1, int(np.ceil(ends[-1] - _SLACK))))
    covering = np.searchsorted(ends, ticks + 1 - _SLACK)  # the segment that ends after the tick
    commands: list[BaseCommand] = []
    for tick, index in zip(ticks.tolist(), covering.tolist(), strict=True):
        if index < len(own) and starts[index] <= tick + _SLACK:
            commands.append(own[index])
            continue
        overlap = np.clip(np.minimum(ends, tick + 1) - np.maximum(starts, tick), 0, None)
        mean = overlap @ twists
        commands.append(BaseCommand(velocity=mean[:3], angular_velocity=mean[3:]))
    return commands
