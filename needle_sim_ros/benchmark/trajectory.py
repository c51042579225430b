# SPDX-License-Identifier: Apache-2.0
"""What a run of a protocol gave and cost, and how far two runs are apart."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needle_sim_ros.benchmark.paper import PaperSimulator, PaperState
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.observation import Observation
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

Array = NDArray[np.float64]

# time steps, in those of the scene, that runs are compared over
_LONGEST = 4
# how late the reference may be, in ticks
_LATE = tuple(part / 8 for part in range(-8, 9) if part)

QUANTITIES = ("tip_deflection", "base_force", "friction_force", "markers")


@dataclass(frozen=True)
class Trajectory:
    """The quantities of a run at its ticks.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s.
    values : dict of ndarray, shape (n, points, 3)
        By name of the quantity: m or N; a scalar is the first of three components.
    """

    time: Array
    values: dict[str, Array]

    def at(self, times: Array) -> Trajectory:
        """Return the run at some times, interpolated linearly between its ticks."""
        index = np.clip(np.searchsorted(self.time, times - 1e-9), 1, len(self.time) - 1)
        start, end = self.time[index - 1], self.time[index]
        part = np.clip((times - start) / (end - start), 0.0, 1.0)[:, None, None]
        values = {k: v[index - 1] * (1 - part) + v[index] * part for k, v in self.values.items()}
        return Trajectory(times, values)


@dataclass(frozen=True)
class Errors:
    """By quantity, as fractions: the largest and the root-mean-square difference.

    `late` is the largest difference that remains when the reference may be a tick early or
    late: what jumps, as force does at puncture and at a reversal, jumps at a tick's end.
    """

    largest: dict[str, float]
    rms: dict[str, float]
    late: dict[str, float]

    @property
    def worst(self) -> float:
        """The largest over all quantities."""
        return max(self.largest.values())


def errors(run: Trajectory, reference: Trajectory) -> Errors:
    """Compare a run with a reference at equal times.

    Differences are lengths of difference vectors at the ticks of the run with the longer
    ticks, in proportion to the largest length of that quantity in the reference's whole run;
    of the markers, the largest over all of them counts.
    """
    coarse = run.time if len(run.time) <= len(reference.time) else reference.time
    common = coarse[coarse <= min(run.time[-1], reference.time[-1]) + 1e-9]
    tick = float(np.diff(coarse).max())
    run = run.at(common)
    here = reference.at(common)
    shifted = [here, *(reference.at(common + part * tick) for part in _LATE)]
    largest, rms, late = {}, {}, {}
    for name, values in run.values.items():
        if values.shape[1] == 0:
            continue
        scale = float(np.linalg.norm(reference.values[name], axis=2).max()) or 1.0
        off = [np.linalg.norm(values - other.values[name], axis=2) / scale for other in shifted]
        largest[name] = float(off[0].max())
        rms[name] = float(np.sqrt((off[0] ** 2).mean(axis=0)).max())
        late[name] = float(np.min(off, axis=0).max())
    return Errors(largest, rms, late)


class Recorded:
    """A simulation that times its ticks and keeps what the benchmark compares.

    Parameters
    ----------
    simulator : Simulator or PaperSimulator
    """

    def __init__(self, simulator: Simulator | PaperSimulator) -> None:
        self.simulator = simulator
        self.tick_times: list[float] = []
        self._inserted: list[bool] = []
        self._times: list[float] = []
        self._values: dict[str, list[Array]] = {name: [] for name in QUANTITIES}

    def tick(self, command: BaseCommand, dt: float) -> None:
        """Step, read what is compared and count the time of both."""
        began = time.perf_counter()
        seen: Observation | PaperState = self.simulator.step(command, dt)
        deflection, force = seen.tip_deflection, seen.base_force
        friction, moved = seen.friction_force, seen.marker_displacements
        self.tick_times.append(time.perf_counter() - began)
        self._inserted.append(seen.process not in (Process.FREE, Process.CONTACT))
        self._times.append(seen.time)
        rows = (deflection[None], force[None], np.array([[friction, 0.0, 0.0]]), moved)
        for values, row in zip(self._values.values(), rows, strict=True):
            values.append(row)

    @property
    def median_inserted(self) -> float:
        """Median time of a tick with the needle in the tissue, s; of all if it never is."""
        inside = np.array(self._inserted)
        return float(np.median(np.array(self.tick_times)[inside if inside.any() else ~inside]))

    @property
    def trajectory(self) -> Trajectory:
        """What was kept so far."""
        return Trajectory(
            np.array(self._times), {name: np.array(v) for name, v in self._values.items()}
        )


def hurried(scene: Scene, factor: float) -> Scene:
    """Return the scene with its protocol moved faster: as deep, in fewer ticks.

    Parts end with whole ticks, also with the steps that are four times as long: Newmark's
    method takes whole steps only, and runs that turn back at other times do not compare.
    """
    whole = _LONGEST * scene.solver.time_step
    protocol = []
    for segment in scene.protocol:
        duration = max(1, round(segment.duration / factor / whole)) * whole
        by = segment.duration / duration
        protocol.append(
            {
                "duration": duration,
                "velocity": [by * v for v in segment.velocity],
                "angular_velocity": [by * v for v in segment.angular_velocity],
            }
        )
    return scene.with_changes({"protocol": protocol})


def driven_in(simulator: Simulator | PaperSimulator, scene: Scene) -> None:
    """Follow a scene's protocol until the needle rests in the tissue or turns back."""
    step = scene.solver.time_step
    for command in protocol_commands(scene.protocol, step):
        if simulator.step(command, step).process in (Process.HOLD, Process.RETRACTION):
            return
