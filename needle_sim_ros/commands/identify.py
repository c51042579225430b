# SPDX-License-Identifier: Apache-2.0
"""``needle_sim identify``: parameters of the tissue from recorded experiments."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    table,
    write_json,
)
from needle_sim_ros.errors import NeedleSimError

if TYPE_CHECKING:
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
    figures = _figures(fit, checks, noise)
    figures |= {"simulations": fitter.residuals.simulations, "wall_time_s": took}
    _print(fit, trials, held, checks, notes, figures)
    if args.output is not None:
        args.output.write_text(with_values(scene, fit.named()).to_yaml(), encoding="utf-8")
        print(f"scene: {args.output}")
    if args.plot is not None:
        _plot(args, trials + held, fit, checks)
    write_json(args.json, _data(fit, trials, held, checks, notes, figures))
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


Checks = tuple[list[dict[str, float]], list[dict[str, float]], list[Any]]


def _validated(residuals: Any, fit: Fit) -> Checks:
    """Return residuals of held-out bags before and after, and what was predicted."""
    start = {p.name: float(v) for p, v in zip(fit.parameters, fit.start, strict=True)}
    before, after = residuals.predictions([start, fit.named()])
    for refused in after:
        if isinstance(refused, str):
            raise NeedleSimError(f"a held-out bag cannot be followed: {refused}")
    return residuals.rms(before), residuals.rms(after), [before, after]


def _figures(fit: Fit, checks: Checks, noise: dict[str, float]) -> dict[str, float]:
    units = {"force": "n", "torque": "nm", "markers": "m", "tip": "m"}
    figures: dict[str, float] = {"reduced_chi_square": fit.reduced_chi_square}
    for name in noise:
        for label, rows in (
            ("before", fit.before),
            ("after", fit.after),
            ("validation_before", checks[0]),
            ("validation", checks[1]),
        ):
            found = [row[name] for row in rows if name in row]
            if found:
                figures[f"{name}_rms_{label}_{units[name]}"] = max(found)
                if label == "validation":
                    above = max(0.0, max(found) ** 2 - noise[name] ** 2) ** 0.5
                    figures[f"{name}_rms_validation_above_noise_{units[name]}"] = above
    return figures


def _print(
    fit: Fit,
    trials: list[Trial],
    held: list[Trial],
    checks: Checks,
    notes: list[str],
    figures: dict[str, float],
) -> None:
    rows: list[tuple[str, ...]] = [
        ("parameter", "start", "value", "standard error", "95 % interval", "unit")
    ]
    for k, parameter in enumerate(fit.parameters):
        low, high = fit.intervals[k]
        rows.append(
            (
                parameter.name,
                f"{fit.start[k]:.4g}",
                f"{fit.values[k]:.4g}",
                f"{fit.standard_errors[k]:.2g}",
                f"{low:.4g} to {high:.4g}",
                parameter.unit,
            )
        )
    print(table(rows, title="parameters", align="<>>><<"))
    names = [p.name for p in fit.parameters]
    if len(names) > 1:
        lines = [("", *names)]
        for name, row in zip(names, fit.correlations, strict=True):
            lines.append((name, *(f"{value:+.2f}" for value in row)))
        print(table(lines, title="correlations", align="<" + ">" * len(names)))
    residual_rows: list[tuple[str, ...]] = [("bag", "quantity", "rms before", "rms after", "unit")]
    from needle_sim_ros.session.experiment import UNITS

    pairs = [*zip(trials, fit.before, fit.after, strict=True)]
    pairs += [*zip(held, checks[0], checks[1], strict=True)]
    for trial, before, after in pairs:
        name = trial.experiment.name + (" (held out)" if trial in held else "")
        for quantity, value in after.items():
            unit = UNITS[quantity]
            residual_rows.append((name, quantity, f"{before[quantity]:.3g}", f"{value:.3g}", unit))
    print(table(residual_rows, title="residuals", align="<<>><"))
    print(
        f"  reduced chi square {fit.reduced_chi_square:.3g};"
        f" {figures['simulations']:.0f} simulations in {figures['wall_time_s']:.1f} s"
    )
    if fit.inflation > 1.0:
        print(
            f"  Residuals are more than noise: variances are multiplied by {fit.inflation:.3g}"
            " (misfit and its correlation in time)."
        )
    for combination in fit.undetermined:
        print(f"  The data do not tell apart: {combination.text()}")
    for note in notes:
        print(f"  {note}")


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


def _data(
    fit: Fit,
    trials: list[Trial],
    held: list[Trial],
    checks: Checks,
    notes: list[str],
    figures: dict[str, float],
) -> dict[str, Any]:
    names = [p.name for p in fit.parameters]
    return {
        "figures": figures,
        "parameters": {
            p.name: {
                "value": fit.values[k],
                "standard_error": fit.standard_errors[k],
                "interval": fit.intervals[k],
                "unit": p.unit,
                "start": fit.start[k],
            }
            for k, p in enumerate(fit.parameters)
        },
        "correlations": {
            a: dict(zip(names, row.tolist(), strict=True))
            for a, row in zip(names, fit.correlations, strict=True)
        },
        "undetermined": [
            {"combination": c.shares, "standard_error": c.standard_error, "text": c.text()}
            for c in fit.undetermined
        ],
        "variance_inflation": fit.inflation,
        "bags": _residuals_of(trials, fit.before, fit.after),
        "validation": _residuals_of(held, checks[0], checks[1]),
        "notes": notes,
    }


def _residuals_of(
    trials: list[Trial], before: list[dict[str, float]], after: list[dict[str, float]]
) -> list[dict[str, Any]]:
    return [
        {"bag": t.experiment.name, "rms_before": b, "rms_after": a}
        for t, b, a in zip(trials, before, after, strict=True)
    ]
