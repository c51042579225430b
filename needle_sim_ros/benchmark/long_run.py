# SPDX-License-Identifier: Apache-2.0
"""A long run of random admissible commands: no drift of equilibrium, no growth of memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from needle_sim_ros.benchmark.equilibrium import residuals
from needle_sim_ros.command import BaseCommand
from needle_sim_ros.errors import CommandError, SolverError
from needle_sim_ros.geometry import rotation_matrix
from needle_sim_ros.observation import Observation
from needle_sim_ros.scene import Scene
from needle_sim_ros.simulator import Simulator

LENGTH = 0.060
_DT = 0.01
_CHECKS = 200
# memory is compared from this share of the run on: by then every response is kept
_WARM = 0.3
_COMPARED = 200


def scene() -> Scene:
    """Return the scene of the long run: 2D, quasi-static, with every law at work."""
    return Scene.from_dict(
        {
            "name": "long-run",
            "dimension": 2,
            "tissue": {
                "size": [0.04, 0.03],
                "thickness": 0.024,
                "youngs_modulus": 15e3,
                "poisson_ratio": 0.49,
                "mesh": {"spacing_across": 2e-3, "spacing_along": 5e-3, "uniform": True},
            },
            "needle": {
                "length": LENGTH,
                "radius": 1e-3,
                "youngs_modulus": 2.1e9,
                "tip": {"bevel_angle": 0.5, "deviation_angle": 0.03},
            },
            "interaction": {
                "friction": {"static": 8.0, "kinetic": 7.0},
                "cutting": {"force": 0.1, "ripple": {"amplitude": 0.2}},
                "puncture": {"force": 0.15},
            },
            "markers": [[0.003, 0.0, -0.004], [-0.006, 0.0, -0.012]],
            "solver": {"track_spacing": 3e-3},
            "base": {"position": [0.0, 0.0, LENGTH + 1e-3]},
        }
    )


def random_commands(simulator: Simulator, draw: np.random.Generator) -> Iterator[BaseCommand]:
    """Make up commands without end: strokes, holds, lateral moves, turns and jumps.

    They keep the base about where its needle is in reach of the tissue; the simulator
    still refuses some.
    """
    while True:
        seen = simulator.observe()
        x, _, z = seen.base_position
        kind = int(draw.integers(0, 10))
        ticks = int(draw.integers(1, 40))
        speed = 10 ** float(draw.uniform(-4, -0.7))
        velocity, turning = [0.0, 0.0, 0.0], 0.0
        if kind < 6:
            # upwards the sooner, the deeper the tip is
            up = (z - LENGTH + 0.024) / 0.03 < draw.uniform()
            velocity[2] = speed if up else -speed
        elif kind == 6:
            velocity[0] = speed * float(draw.choice([-1, 1]))
            ticks = min(ticks, 1 + int(4e-3 / (speed * _DT)))
            if abs(x) > 3e-3:  # back to the middle
                velocity[0] = -math.copysign(speed, x)
        elif kind == 7:
            axis = rotation_matrix(seen.base_orientation)[:, 2]
            lean = math.atan2(-axis[0], -axis[2])
            turning = float(draw.uniform(-0.05, 0.05)) / (ticks * _DT)
            if abs(lean) > 0.06:  # back upright
                turning = -lean / (ticks * _DT)
        elif kind == 8:
            # about the middle: a random walk would end beside the tissue
            place = [0.5 * x + float(draw.normal(0, 1e-3)), 0.0, z + float(draw.normal(0, 1e-3))]
            yield BaseCommand(position=place)
            continue
        command = BaseCommand(velocity=velocity, angular_velocity=[0.0, turning, 0.0])
        for _ in range(ticks):
            yield command


def long_run(
    ticks: int, seed: int = 7, progress: Callable[[int], None] | None = None
) -> dict[str, float]:
    """Put a simulator through random commands.

    Parameters
    ----------
    ticks : int
    seed : int
    progress : callable, optional
        Called with the number of ticks done.

    Returns
    -------
    dict
        ``ticks`` carried out; ``refused`` commands, of which ``refused_changed`` changed the
        state; ``faults``: ticks not finite or without a solution; ``worst_residual`` of
        equilibrium, and of the last tenth of the checks relative to the first
        (``residual_drift``); ``rss_growth_mb`` after the first third;
        ``fresh_difference``: the largest difference, relative, between the simulator after
        the run and a fresh one, both put through the same commands from a pose above.
    """
    draw = np.random.default_rng(seed)
    simulator = Simulator(scene())
    commands = random_commands(simulator, draw)
    refused = changed = faults = 0
    found: list[float] = []
    every = max(1, ticks // _CHECKS)
    warm = begun = resident_mb()
    for tick in range(1, ticks + 1):
        before = simulator.snapshot()
        try:
            seen = simulator.step(next(commands), _DT)
        except CommandError:
            refused += 1
            changed += simulator.snapshot() is not before
            # what the stage cannot do it is not told again: go up
            seen = _lifted(simulator)
        except SolverError:
            faults += 1
            seen = _lifted(simulator)
        if not math.isfinite(float(seen.base_force.sum()) + float(seen.tip_position.sum())):
            faults += 1
        if tick % every == 0:
            found.append(residuals(simulator, before).worst()[0])
            if progress is not None:
                progress(tick)
        if tick == int(_WARM * ticks):
            warm = resident_mb()
    tenth = max(1, len(found) // 10)
    return {
        "ticks": simulator.ticks,
        "refused": refused,
        "refused_changed": changed,
        "faults": faults,
        "worst_residual": max(found),
        "residual_drift": max(found[-tenth:]) / max(max(found[:tenth]), 1e-300),
        "rss_growth_mb": resident_mb() - warm,
        "rss_growth_in_all_mb": resident_mb() - begun,
        "fresh_difference": _against_fresh(simulator),
    }


def _lifted(simulator: Simulator) -> Observation:
    """Draw the needle back: along itself, or else straight up."""
    axis = rotation_matrix(simulator.observe().base_orientation)[:, 2]
    try:
        return simulator.step(BaseCommand(velocity=-0.05 * axis), _DT)
    except CommandError:
        return simulator.step(BaseCommand(velocity=[0.0, 0.0, 0.05]), _DT)


def _against_fresh(old: Simulator) -> float:
    """Compare with a fresh simulator put through the same commands."""
    fresh = Simulator(old.scene)
    pose = {"position": [7.3e-3, 0.0, LENGTH + 1e-3], "orientation": [1.0, 0.0, 0.0, 0.0]}
    lifted = {"position": [7.3e-3, 0.0, LENGTH + 5e-3]}
    worst = 0.0
    series = []
    for simulator in (old, fresh):
        while simulator.observe().insertion_depth > 0:
            _lifted(simulator)
        simulator.step(BaseCommand(**lifted), _DT)
        simulator.step(BaseCommand(**pose), _DT)
        draw = np.random.default_rng(11)
        rows = []
        for tick in range(_COMPARED):
            wave = 5e-3 * float(draw.uniform(0.5, 1.0)) * (1 if tick % 50 < 35 else -1)
            seen = simulator.step(
                BaseCommand(velocity=[2e-3 * float(draw.normal()), 0.0, -wave]), _DT
            )
            rows.append(
                np.concatenate([seen.base_force, seen.tip_position, seen.marker_positions.ravel()])
            )
        series.append(np.array(rows))
    apart = np.abs(series[0] - series[1]).max(axis=0)
    scale = np.maximum(np.abs(series[1]).max(axis=0), 1e-12)
    worst = float((apart / scale).max())
    return worst


def resident_mb() -> float:
    """Return the resident memory of this process, MB."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return math.nan
