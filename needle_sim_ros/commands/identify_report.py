# SPDX-License-Identifier: Apache-2.0
"""What ``needle_sim identify`` prints and writes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from needle_sim_ros.commands.output import table

if TYPE_CHECKING:
    from needle_sim_ros.identify.fit import Fit
    from needle_sim_ros.identify.residuals import Trial

# Of held-out bags: residuals before and after, and what was predicted before and after.
Checks = tuple[list[dict[str, float]], list[dict[str, float]], list[Any]]


def figures_of(fit: Fit, checks: Checks, noise: dict[str, float]) -> dict[str, float]:
    """Return root-mean-square residuals, the largest of all bags, by name."""
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


def print_fit(
    fit: Fit,
    trials: list[Trial],
    held: list[Trial],
    checks: Checks,
    notes: list[str],
    figures: dict[str, float],
) -> None:
    """Print parameters, correlations, residuals, and what is to be said about them."""
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


def fit_data(
    fit: Fit,
    trials: list[Trial],
    held: list[Trial],
    checks: Checks,
    notes: list[str],
    figures: dict[str, float],
) -> dict[str, Any]:
    """Return the content of the JSON file."""
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
