# SPDX-License-Identifier: Apache-2.0
"""How well parameters are found again in noisy sessions whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from needle_sim_ros.benchmark.result import BenchmarkResult
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.fit import Fit, Fitter
from needle_sim_ros.identify.model import quasi_static
from needle_sim_ros.identify.parameters import DEFAULT, Parameter, chosen, values_in, with_values
from needle_sim_ros.identify.prediction import Predicted
from needle_sim_ros.identify.residuals import NOISE, Residuals, Trial
from needle_sim_ros.parallel import executor
from needle_sim_ros.protocol import protocol_commands
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.experiment import Experiment, Measured
from needle_sim_ros.session.motion import Motion

_TICK = 0.05  # s
_DRAWS, _QUICK_DRAWS = 100, 20
# what the fit starts from, as multiples of the truth
_START = {
    "youngs_modulus": 0.7,
    "friction.static": 1.3,
    "friction.kinetic": 0.75,
    "cutting.force": 1.3,
}
_COARSE = {
    "tissue.mesh.spacing_across": 2e-3,
    "tissue.mesh.spacing_along": 4e-3,
    "solver.track_spacing": 2e-3,
}
# Back and forth at depth and slowly out: static friction shows while the slip is short.
_SESSION = [
    {"duration": 67 / 3, "velocity": [0, 0, -3e-3]},
    *(3 * [{"duration": 4.0, "velocity": [0, 0, v]} for v in (1e-3, -1e-3)]),
    {"duration": 2.0},
    {"duration": 15.0, "velocity": [0, 0, 0.2e-3]},
    {"duration": 22.0, "velocity": [0, 0, 3e-3]},
]
# held out: another speed and depth, and a stop on the way
_HELD_OUT = [
    {"duration": 8.0, "velocity": [0, 0, -5e-3]},
    {"duration": 2.0},
    {"duration": 4.0, "velocity": [0, 0, -2.5e-3]},
    {"duration": 3.0},
    {"duration": 10.0, "velocity": [0, 0, 5e-3]},
]
Advance = Callable[[int, int], None]


class _Draws(NamedTuple):
    """Estimates and standard errors of all draws, (draws, p)."""

    values: Vector
    errors: Vector


def identify(
    scene: Scene,
    *,
    quick: bool = False,
    progress: Advance = lambda done, total: None,
    workers: int | None = None,
) -> BenchmarkResult:
    """Fit noisy sessions of a scene, and predict one that was held out.

    The first draw of noise is fitted from a start 25 to 30 % off. The others go on from
    there: a Gauss-Newton step with the derivatives found, a simulation, another step.

    Parameters
    ----------
    scene : Scene
        Simulated without inertia; its values are the truth.
    quick : bool
        A coarse mesh and 20 draws instead of 100.
    progress : callable
        Called with simulations done and expected.
    workers : int, optional
        Processes; by default one per core.
    """
    scene = quasi_static(scene)
    if quick:
        scene = scene.with_changes(_COARSE)
    draws = _QUICK_DRAWS if quick else _DRAWS
    parameters = chosen(DEFAULT)
    truth = np.array(list(values_in(scene, parameters).values()))
    session = _commanded(scene.with_changes({"protocol": _SESSION}), "session")
    held_out = _commanded(scene.with_changes({"protocol": _HELD_OUT}), "held out")
    expected = draws + 40
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        progress(done, max(expected, done))

    with executor(workers) as pool:
        trials = [Trial(session, scene), Trial(held_out, scene)]
        ((exact, unseen),) = Residuals(trials, NOISE, pool, advance).predictions([{}])
        assert not isinstance(exact, str) and not isinstance(unseen, str)
        noisy = [_with_noise(session, exact, seed) for seed in range(draws)]
        start = truth * np.array([_START[p.name] for p in parameters])
        begun = with_values(
            scene, {p.name: float(v) for p, v in zip(parameters, start, strict=True)}
        )
        residuals = Residuals([Trial(noisy[0], begun)], NOISE, pool, advance)
        fitter = Fitter(residuals, parameters, start)
        fit = fitter.fit()
        fits = _continued(fitter, fit, noisy)
        ((predicted,),) = Residuals([Trial(held_out, begun)], NOISE, pool, advance).predictions(
            [fit.named()]
        )
        assert not isinstance(predicted, str)
    return _result(scene.name, parameters, truth, fit, fits, unseen, predicted)


def _commanded(scene: Scene, name: str) -> Experiment:
    """Return an experiment with the scene's protocol, at whose ticks everything is measured."""
    motions = [Motion.of(command) for command in protocol_commands(scene.protocol, _TICK)]
    time = np.asarray(_TICK * np.arange(1, len(motions) + 1), dtype=float)
    nothing = {name: Measured(time, np.zeros((len(time), 3))) for name in NOISE}
    return Experiment(name, _TICK, motions, nothing)


def _with_noise(experiment: Experiment, exact: Predicted, seed: int) -> Experiment:
    random = np.random.default_rng(seed)
    measured = {
        name: Measured(
            experiment.measured[name].time, rows + NOISE[name] * random.standard_normal(rows.shape)
        )
        for name, rows in exact.items()
    }
    return replace(experiment, measured=measured)


def _continued(fitter: Fitter, fit: Fit, noisy: Sequence[Experiment]) -> _Draws:
    """Fit all draws from the fit of the first."""
    u = fit.values / fitter.size
    jacobian = fitter.jacobian(u, central=True)
    solve = np.linalg.pinv(jacobian)
    trial = fitter.residuals.trials[0]

    def residual(experiment: Experiment, predicted: Predicted | str) -> Vector:
        block = Residuals([Trial(experiment, trial.scene)], NOISE, fitter.residuals.pool)
        return block.weighted([predicted])

    first = [u - solve @ residual(e, fit.predicted_after[0]) for e in noisy]
    again = fitter.residuals.predictions([fitter.point(v) for v in first])
    values = [
        v - solve @ residual(e, predicted)
        for v, e, (predicted,) in zip(first, noisy, again, strict=True)
    ]
    values[0] = u
    errors = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    return _Draws(np.array(values) * fitter.size, np.tile(errors * fitter.size, (len(values), 1)))


def _result(
    name: str,
    parameters: list[Parameter],
    truth: Vector,
    fit: Fit,
    fits: _Draws,
    unseen: Predicted,
    predicted: Predicted,
) -> BenchmarkResult:
    relative = fits.values / truth - 1.0
    inside = np.abs(fits.values - truth) <= stats.norm.ppf(0.975) * fits.errors
    result = BenchmarkResult("identify", name)
    for k, parameter in enumerate(parameters):
        short = parameter.name.replace(".", "_")
        result.figures[f"{short}_error"] = float(abs(fit.values[k] / truth[k] - 1.0))
        result.figures[f"{short}_worst_error"] = float(np.abs(relative[:, k]).max())
        result.figures[f"{short}_inside_95"] = float(inside[:, k].mean())
        result.table.append(
            {
                "parameter": parameter.name,
                "unit": parameter.unit,
                "truth": truth[k],
                "start": fit.start[k],
                "fitted": fit.values[k],
                "standard error": fit.standard_errors[k],
                "spread of draws": float(fits.values[:, k].std(ddof=1)),
                "inside": int(inside[:, k].sum()),
                "draws": len(inside),
            }
        )
    result.figures["least_inside_95"] = float(inside.mean(axis=0).min())
    for quantity, unit in (("force", "n"), ("markers", "m")):
        apart = predicted[quantity] - unseen[quantity]
        result.figures[f"held_out_{quantity}_rms_{unit}"] = float(np.sqrt(np.mean(apart**2)))
    result.figures["reduced_chi_square"] = fit.reduced_chi_square
    return result
