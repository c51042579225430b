# SPDX-License-Identifier: Apache-2.0
"""How a plan fares under uncertain parameters; results stream to a file and are resumed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needle_sim_ros import results_file
from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.plain import plain
from needle_sim_ros.planning.insertion import Insertion
from needle_sim_ros.planning.uncertainty import Uncertainty
from needle_sim_ros.planning.work import Trial, side_by_side
from needle_sim_ros.results_file import ResultsFile
from needle_sim_ros.scene import Scene

VERSION = 1
_KIND = "study"
_SUBJECT = "scene, plan, uncertainty or seed"
# trials handed out before their results are written
_BATCH = 32


@dataclass(frozen=True)
class Study:
    """What is studied.

    Attributes
    ----------
    scene : Scene
        A planning scene.
    insertion : Insertion
        Kept as planned in every sample.
    target : tuple of 3 floats
        m.
    uncertainty : Uncertainty
    seed : int
    """

    scene: Scene
    insertion: Insertion
    target: tuple[float, ...]
    uncertainty: Uncertainty
    seed: int = 0

    def digest(self) -> str:
        """Return what the study's results hang on, in short."""
        # rounded: a plan made again on another machine may differ in the last bits
        insertion = {k: _rounded(v) for k, v in asdict(self.insertion).items()}
        about: list[Any] = [self.scene.to_dict(), insertion, list(self.target)]
        about += [self.uncertainty.parameters, self.seed]
        text = json.dumps(plain(about), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def trial(self, number: int) -> Trial:
        """Return the trial of a sample."""
        changes = self.uncertainty.draw(self.scene, self.seed, number)
        return Trial(self.insertion, self.target, changes)


def _rounded(value: object) -> object:
    if isinstance(value, float):
        return float(f"{value:.9g}")
    return [_rounded(v) for v in value] if isinstance(value, (list, tuple)) else value


@dataclass(frozen=True)
class Spread:
    """Distribution of the miss.

    Attributes
    ----------
    misses : ndarray, shape (n,)
        m; of insertions that came to their end.
    failed : int
        Insertions that the model refused.
    """

    misses: Vector
    failed: int

    def figures(self, radius: float) -> dict[str, float | None]:
        """Return mean, quantiles and the probability of a miss within a radius, m."""
        count = len(self.misses) + self.failed
        if len(self.misses) == 0:
            return {"samples": count, "failed": self.failed, "hit_probability": 0.0}
        low, middle, high = np.quantile(self.misses, [0.05, 0.5, 0.95]).tolist()
        hits = int((self.misses <= radius).sum())
        return {
            "samples": count,
            "failed": self.failed,
            "hit_radius_m": radius,
            "hit_probability": hits / count,
            "hit_probability_error": (hits / count * (1 - hits / count) / count) ** 0.5,
            "miss_mean_m": float(self.misses.mean()),
            "miss_p05_m": low,
            "miss_median_m": middle,
            "miss_p95_m": high,
        }


def run_study(
    study: Study,
    samples: int,
    executor: Executor,
    path: Path | None = None,
    tick: Callable[[int], object] = lambda done: None,
) -> Spread:
    """Roll out samples, those that a file lacks; append their results to it.

    Parameters
    ----------
    study : Study
    samples : int
    executor : concurrent.futures.Executor
    path : Path, optional
        JSON lines: a header, then one sample a line.
    tick : callable
        Told how many samples there are.

    Raises
    ------
    NeedleSimError
        When the file is no study, of another version, or of another plan.
    """
    if samples < 1:
        raise NeedleSimError(f"samples {samples}: must be at least 1")
    file = None if path is None else ResultsFile(path, _KIND, VERSION, study.digest(), _SUBJECT)
    known = {} if file is None else _misses(file)
    results = {k: v for k, v in known.items() if k < samples}
    missing = [number for number in range(samples) if number not in results]
    tick(len(results))
    for start in range(0, len(missing), _BATCH):
        numbers = missing[start : start + _BATCH]
        trials = [study.trial(number) for number in numbers]
        outcomes = side_by_side(study.scene, trials, executor, 4)
        for number, trial, outcome in zip(numbers, trials, outcomes, strict=True):
            miss = None if outcome.stopped else outcome.miss
            results[number] = miss
            if file is not None:
                line = {
                    "sample": number,
                    "miss_m": miss,
                    "tip": outcome.tip,
                    "target": outcome.target,
                    "peak_force_n": outcome.peak_force,
                    "changes": dict(trial.changes),
                    "stopped": outcome.stopped,
                }
                file.append(line)
            tick(len(results))
    misses = [miss for miss in results.values() if miss is not None]
    return Spread(np.array(misses), len(results) - len(misses))


def _misses(file: ResultsFile) -> dict[int, float | None]:
    try:
        return {int(entry["sample"]): entry["miss_m"] for entry in file.entries}
    except (KeyError, TypeError, ValueError):
        raise NeedleSimError(f"{file.path}: a result is not a sample of a study") from None


def check_version(path: Path) -> None:
    """Refuse, before any work, a file that is no study, or of another version."""
    results_file.check_version(path, _KIND, VERSION)
