# SPDX-License-Identifier: Apache-2.0
"""``needle_sim identify``: parameters of the tissue from recorded experiments."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needle_sim_ros.commands.identify_report import figures_of, fit_data, print_fit
from needle_sim_ros.commands.options import (
    add_json,
    add_mapping,
    add_set,
    load_scene,
    parse_overrides,
)
from needle_sim_ros.commands.output import (
    check_picture,
    check_writable,
    progress,
    write_json,
)
from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
    from needle_sim_ros.commands.identify_report import Checks
    from needle_sim_ros.identify.fit import Fit
    from needle_sim_ros.identify.residuals import Trial

NAME = "identify"
HELP = "find the parameters that explain recorded experiments"
DESCRIPTION = """Fit parameters to the forces and marker displacements of one or several bags by
least squares. Reports values, 95 % intervals, correlations, and what the data cannot tell apart.
Bags recorded by others are read as --topic or --mapping say."""
EXAMPLES = (
    "identify bags/gao2016 --set tissue.youngs_modulus=12000",
    "identify first second --validate third --output fitted.yaml --plot fit.png",
    "identify experiment --scene gao2016 --mapping topics.yaml --noise force=0.05"
    " --parameters friction.kinetic,cutting.force",
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("bags", metavar="BAG", nargs="+", type=Path, help="a bag to fit to")
    parser.add_argument("--scene", metavar="SCENE", help="default: the one in each bag")
    add_mapping(parser)
    parser.add_argument(
        "--parameters",
        metavar="NAME,...",
        help="what to fit (default: youngs_modulus,friction.static,friction.kinetic,cutting.force)",
    )
    parser.add_argument(
        "--noise",
        metavar="NAME=X,...",
        help="standard deviations of what is fitted to: force, torque, markers, tip; SI units"
        " (default: force=0.02,markers=1e-4)",
    )
    parser.add_argument("--rate", metavar="HZ", type=float, help="join ticks to fewer a second")
    parser.add_argument(
        "--validate", metavar="BAG", type=Path, action="append", default=[], help="hold out"
    )
    parser.add_argument(
        "--output", metavar="SCENE.yaml", type=Path, help="write the scene with the values found"
    )
    parser.add_argument("--plot", metavar="FILE", type=Path, help="png, svg or pdf by the suffix")
    parser.add_argument("--workers", metavar="N", type=int, help="processes (default: all cores)")
    parser.add_argument("--dask", metavar="ADDRESS", help="scheduler of a Dask cluster to work on")
    add_set(parser)
    add_json(parser)


def execute(args: argparse.Namespace) -> int:
    """Read, fit, validate, report."""
    check_writable(args.json)
    check_picture(args.plot)
    check_writable(args.output)
    if args.rate is not None and not 0.1 <= args.rate <= 1e4:
        raise NeedleSimError(f"--rate {args.rate:g}: must be 0.1 to 10000 Hz")
    import numpy as np

    from needle_sim_ros.identify.fit import Fitter
    from needle_sim_ros.identify.parameters import DEFAULT, chosen, values_in, with_values
    from needle_sim_ros.identify.residuals import Residuals, read_noise
    from needle_sim_ros.parallel import executor

    names = DEFAULT if args.parameters is None else args.parameters.split(",")
    parameters = chosen([name.strip() for name in names])
    noise = read_noise(args.noise)
    begin = time.perf_counter()
    trials, notes = _trials(args, args.bags)
    held, more = _trials(args, args.validate)
    notes += [note for note in more if note not in notes]
    scene = trials[0].scene
    start = values_in(scene, parameters)
    trials, held = [_started(t, start) for t in trials], [_started(t, start) for t in held]
    with executor(args.workers, args.dask) as pool, progress(0, "fitting", unit="run") as bar:
        fitter = Fitter(
            Residuals(trials, noise, pool, bar.update),
            parameters,
            np.array(list(start.values())),
        )
        fit = fitter.fit()
        checks = _validated(Residuals(held, noise, pool), fit) if held else ([], [], [])
    took = time.perf_counter() - begin
    figures = figures_of(fit, checks, noise)
    figures |= {"simulations": fitter.residuals.simulations, "wall_time_s": took}
    print_fit(fit, trials, held, checks, notes, figures)
    if args.output is not None:
        args.output.write_text(with_values(scene, fit.named()).to_yaml(), encoding="utf-8")
        print(f"scene: {args.output}")
    if args.plot is not None:
        _plot(args, trials + held, fit, checks)
    write_json(args.json, fit_data(fit, trials, held, checks, notes, figures))
    return 0


def _trials(args: argparse.Namespace, bags: list[Path]) -> tuple[list[Trial], list[str]]:
    from needle_sim_ros.identify.model import quasi_static
    from needle_sim_ros.identify.residuals import Trial
    from needle_sim_ros.session.foreign import read_experiment
    from needle_sim_ros.session.mapping import read_mapping

    mapping = read_mapping(args.mapping, args.topics)
    given = None if args.scene is None else load_scene(args.scene, args.overrides)
    overrides = parse_overrides(args.overrides)
    trials, notes = [], []
    for bag in bags:
        experiment = read_experiment(bag, mapping, given)
        scene = experiment.scene(given)
        if given is None and overrides:
            scene = scene.with_changes(overrides)
        if scene.solver.dynamics == "newmark" and overrides.get("solver.dynamics") is None:
            scene = quasi_static(scene)
            notes.append(
                "Fitted without inertia (--set solver.dynamics=newmark keeps it, and takes long)."
            )
        if args.rate is not None:
            experiment = experiment.coarser(args.rate)
        notes += [f"{experiment.name}: {note}" for note in experiment.notes]
        trials.append(Trial(experiment, scene))
    return trials, list(dict.fromkeys(notes))


def _started(trial: Trial, start: dict[str, float]) -> Trial:
    """Start every trial from the values of the first one's scene."""
    from needle_sim_ros.identify.parameters import with_values
    from needle_sim_ros.identify.residuals import Trial

    return Trial(trial.experiment, with_values(trial.scene, start))


def _validated(residuals: Any, fit: Fit) -> Checks:
    """Return residuals of held-out bags before and after, and what was predicted."""
    start = {p.name: float(v) for p, v in zip(fit.parameters, fit.start, strict=True)}
    before, after = residuals.predictions([start, fit.named()])
    for refused in after:
        if isinstance(refused, str):
            raise NeedleSimError(f"a held-out bag cannot be followed: {refused}")
    return residuals.rms(before), residuals.rms(after), [before, after]


def _plot(args: argparse.Namespace, trials: list[Trial], fit: Fit, checks: Checks) -> None:
    from needle_sim_ros.view.files import save_figure
    from needle_sim_ros.view.fit import Curves, fit_figure

    before, after = [*fit.predicted_before], [*fit.predicted_after]
    if checks[2]:
        before, after = before + checks[2][0], after + checks[2][1]
    curves = []
    for trial, first, last in zip(trials, before, after, strict=True):
        known = trial.experiment.measured
        models = {
            name: rows
            for name, rows in (("before", first), ("after", last))
            if not isinstance(rows, str)
        }
        kept = [name for name in known if all(name in rows for rows in models.values())]
        curves.append(
            Curves(
                trial.experiment.name,
                {name: known[name].time for name in kept},
                {name: known[name].values for name in kept},
                models,
            )
        )
    values = ", ".join(
        f"{p.name} {v:.4g} {p.unit}" for p, v in zip(fit.parameters, fit.values, strict=True)
    )
    save_figure(fit_figure(curves, "identified", values), args.plot)
    print(f"plot: {args.plot}")
