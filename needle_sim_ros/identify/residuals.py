# SPDX-License-Identifier: Apache-2.0
"""Residuals of one or several experiments as one vector, each divided by its noise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from needle_sim_ros.errors import NeedleSimError, SessionError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.parameters import Values
from needle_sim_ros.identify.prediction import Predicted, only, predict
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.experiment import UNITS, Experiment

# Standard deviations taken when none are given: a common force sensor, a common tracker.
NOISE = {"force": 0.02, "markers": 1e-4}


def read_noise(text: str | None) -> dict[str, float]:
    """Read ``force=0.02,markers=1e-4``: what is named is used, and nothing else.

    Raises
    ------
    NeedleSimError
        On other names or numbers.
    """
    if text is None:
        return dict(NOISE)
    noise = {}
    for part in text.split(","):
        name, _, number = part.strip().partition("=")
        try:
            value = float(number)
        except ValueError:
            value = 0.0
        if name not in UNITS or not 0 < value < float("inf"):
            raise NeedleSimError(
                f"--noise {part}: must be NAME=STANDARD_DEVIATION > 0 with a name of"
                f" {', '.join(f'{n} ({u})' for n, u in UNITS.items())}"
            )
        noise[name] = value
    return noise


@dataclass(frozen=True, eq=False)
class Trial:
    """An experiment and the scene that it is simulated in."""

    experiment: Experiment
    scene: Scene


class Residuals:
    """Weighted residuals over trials.

    Parameters
    ----------
    trials : sequence of Trial
    noise : mapping of str to float
        Standard deviation by quantity; only these are used.
    pool : Executor
        One task for each trial and point.
    advance : callable
        Called after each simulation.

    Raises
    ------
    SessionError
        When a trial has none of the quantities.
    """

    def __init__(
        self,
        trials: Sequence[Trial],
        noise: Mapping[str, float],
        pool: Executor,
        advance: Callable[[], object] = lambda: None,
    ) -> None:
        self.noise, self.pool, self._advance = noise, pool, advance
        self.trials = [Trial(only(t.experiment, list(noise)), t.scene) for t in trials]
        for trial in self.trials:
            if not trial.experiment.measured:
                raise SessionError(
                    f"{trial.experiment.name}: nothing to fit to: it has none of {', '.join(noise)}"
                )
        self.simulations = 0

    def predictions(self, points: Sequence[Values]) -> list[list[Predicted | str]]:
        """Simulate every trial at every point, all at once; by point, then by trial."""
        futures = [
            [self.pool.submit(predict, t.scene, t.experiment, dict(p)) for t in self.trials]
            for p in points
        ]
        found = []
        for row in futures:
            found.append([self._result(future.result()) for future in row])
        return found

    def _result(self, found: Predicted | str) -> Predicted | str:
        self.simulations += 1
        self._advance()
        return found

    def at(self, points: Sequence[Values]) -> list[Vector]:
        """Return the weighted residuals at points; NaN where the model refuses a point."""
        return [self.weighted(predictions) for predictions in self.predictions(points)]

    def weighted(self, predictions: Sequence[Predicted | str]) -> Vector:
        """Return the residuals of one point, divided by the noise; 0 where nothing was seen."""
        return np.concatenate(
            [part.ravel() for block in self.blocks(predictions) for part in block.values()]
        )

    def blocks(self, predictions: Sequence[Predicted | str]) -> list[dict[str, Vector]]:
        """Return the same by trial and quantity, as rows (n, components)."""
        found = []
        for trial, predicted in zip(self.trials, predictions, strict=True):
            block = {}
            for name, measured in trial.experiment.measured.items():
                values = _kept(measured.values, trial.scene.dimension)
                if isinstance(predicted, str):
                    block[name] = np.full(values.shape, np.nan)
                    continue
                apart = _kept(predicted[name], trial.scene.dimension) - values
                block[name] = np.where(np.isnan(values), 0.0, apart) / self.noise[name]
            found.append(block)
        return found

    def rms(self, predictions: Sequence[Predicted | str]) -> list[dict[str, float]]:
        """Return root-mean-square residuals by trial and quantity, in their units."""
        found = []
        for trial, block in zip(self.trials, self.blocks(predictions), strict=True):
            row = {}
            for name, part in block.items():
                seen = np.isfinite(
                    _kept(trial.experiment.measured[name].values, trial.scene.dimension)
                ).sum()
                row[name] = float(self.noise[name] * np.sqrt((part**2).sum() / max(1, seen)))
            found.append(row)
        return found

    @property
    def count(self) -> int:
        """Number of measured numbers."""
        return sum(
            int(np.isfinite(_kept(m.values, t.scene.dimension)).sum())
            for t in self.trials
            for m in t.experiment.measured.values()
        )


def _kept(values: Vector, dimension: int) -> Vector:
    """Return rows (n, components); a 2D scene says nothing about y."""
    kept = values if dimension == 3 else values[..., [0, 2]]
    return np.asarray(kept.reshape(len(kept), -1))
