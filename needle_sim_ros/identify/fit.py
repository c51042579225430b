# SPDX-License-Identifier: Apache-2.0
"""Parameters by least squares, with what the data say about them and what they do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from needle_sim_ros.errors import NeedleSimError
from needle_sim_ros.geometry import Vector
from needle_sim_ros.identify.coordinates import Coordinates
from needle_sim_ros.identify.parameters import Parameter
from needle_sim_ros.identify.prediction import Predicted
from needle_sim_ros.identify.residuals import Residuals

_STEP = 0.01  # of finite differences, in sizes of the parameters
_MISFIT = 1.2  # reduced chi square from which residuals are more than noise
_LOOSE = 0.1  # standard error, in sizes, from which a combination counts as not determined
_NAMED = 0.3  # of the largest share, from which a parameter is named in a combination
_MOST_EVALUATIONS = 50


@dataclass(frozen=True)
class Combination:
    """A direction in which parameters can change with little effect on the data.

    Attributes
    ----------
    shares : mapping of str to float
        Change of each parameter, in its size (of positive ones: relative).
    standard_error : float
        Along the direction, in the same measure; infinite when the data say nothing.
    """

    shares: Mapping[str, float]
    standard_error: float

    def text(self) -> str:
        """Return it in words."""
        parts = [f"{share:+.2f} {name}" for name, share in self.shares.items()]
        size = self.standard_error
        known = "has no effect" if size == float("inf") else f"known to {100 * size:.0f} % only"
        return f"{' '.join(parts)}: {known}"


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit of p parameters.

    Attributes
    ----------
    parameters : list of Parameter
    start, values, standard_errors : ndarray, shape (p,)
    intervals : ndarray, shape (p, 2)
        95 %.
    correlations : ndarray, shape (p, p)
    undetermined : list of Combination
    before, after : list of dict
        Root-mean-square residuals by trial and quantity, in their units.
    predicted_before, predicted_after : list
        Predictions by trial.
    reduced_chi_square : float
    inflation : float
        What the variances were multiplied by because residuals are more than noise.
    """

    parameters: list[Parameter]
    start: Vector
    values: Vector
    standard_errors: Vector
    intervals: Vector
    correlations: Vector
    undetermined: list[Combination]
    before: list[dict[str, float]]
    after: list[dict[str, float]]
    predicted_before: Sequence[Predicted | str]
    predicted_after: Sequence[Predicted | str]
    reduced_chi_square: float
    inflation: float

    def named(self) -> dict[str, float]:
        """Return the values by name."""
        return {p.name: float(v) for p, v in zip(self.parameters, self.values, strict=True)}


class Fitter:
    """Fits parameters to residuals.

    Parameters
    ----------
    residuals : Residuals
    parameters : list of Parameter
    start : ndarray, shape (p,)
        Values to start from; they are the sizes of positive parameters.

    Raises
    ------
    NeedleSimError
        When a positive parameter starts at zero, or the lower of a pair above the other.
    """

    def __init__(self, residuals: Residuals, parameters: list[Parameter], start: Vector) -> None:
        self.residuals, self.parameters, self.start = residuals, parameters, start
        self.coordinates = Coordinates(parameters, start)
        self.size = self.coordinates.size
        self._known: dict[bytes, Vector] = {}

    def point(self, u: Vector) -> dict[str, float]:
        """Return parameter values of a point in sizes."""
        return {p.name: float(v) for p, v in zip(self.parameters, u * self.size, strict=True)}

    def at(self, u: Vector) -> Vector:
        """Return the weighted residuals at a point in sizes."""
        key = u.tobytes()
        if key not in self._known:
            self._known = {key: self.residuals.at([self.point(u)])[0]}
        return self._known[key]

    def jacobian(self, u: Vector, central: bool = False) -> Vector:
        """Return derivatives of the residuals by u, (n, p), by differences; all points at once.

        A side on which the model refuses the parameters is left out.

        Raises
        ------
        NeedleSimError
            When it refuses both.
        """
        return self.coordinates.by_sizes(self._slopes(self.coordinates.searched(u), central))

    def _slopes(self, w: Vector, central: bool) -> Vector:
        """Return derivatives by the numbers that are searched, (n, p)."""
        within, units = self.coordinates, np.eye(len(w))
        room = {1: w + _STEP <= within.high, -1: w - _STEP >= within.low}
        sides = []
        for k in range(len(w)):
            first = 1 if room[1][k] else -1
            sides += [(k, first)] + ([(k, -first)] if central and room[-first][k] else [])
        found: dict[tuple[int, int], Vector] = {}
        for _ in range(2):  # the second time the other side of what was refused
            residuals = self._points([w + sign * _STEP * units[k] for k, sign in sides])
            pairs = zip(sides, residuals, strict=True)
            found |= {side: r for side, r in pairs if np.isfinite(r).all()}
            got = {k for k, _ in found}
            sides = [(k, -s) for k, s in sides if k not in got and room[-s][k]]
            if not sides:
                break
        columns = []
        for k in range(len(w)):
            known = {sign: found[k, sign] for sign in (1, -1) if (k, sign) in found}
            if not known:
                here = self.point(within.sized(w))
                raise NeedleSimError(
                    f"the model refuses parameters beside {here}: start elsewhere (--set)"
                )
            ahead = known[1] if 1 in known else self.at(within.sized(w))
            behind = known[-1] if -1 in known else self.at(within.sized(w))
            columns.append((ahead - behind) / (len(known) * _STEP))
        return np.column_stack(columns)

    def _points(self, places: Sequence[Vector]) -> list[Vector]:
        """Return the residuals at places of the search."""
        return self.residuals.at([self.point(self.coordinates.sized(w)) for w in places])

    def fit(self) -> Fit:
        """Fit by scipy's trust-region least squares, from the start.

        Raises
        ------
        NeedleSimError
            When the model refuses the start.
        """
        u0 = self.start / self.size
        (before,) = self.residuals.predictions([self.point(u0)])
        for refused in before:
            if isinstance(refused, str):
                raise NeedleSimError(f"the scene cannot follow the commands: {refused}")
        self._known = {u0.tobytes(): self.residuals.weighted(before)}
        within = self.coordinates

        def residuals(w: Vector) -> Vector:
            return self.at(within.sized(w))

        def slopes(w: Vector) -> Vector:
            return self._slopes(w, central=False)

        solved = least_squares(
            residuals,
            within.searched(u0),
            jac=slopes,
            bounds=(within.low, within.high),
            ftol=1e-6,
            xtol=1e-5,
            gtol=1e-10,
            max_nfev=_MOST_EVALUATIONS,
        )
        u, jacobian = self._polished(within.sized(solved.x))
        (after,) = self.residuals.predictions([self.point(u)])
        return self.described(u, jacobian, before, after)

    def _polished(self, u: Vector) -> tuple[Vector, Vector]:
        """Take one more step with central differences, where it helps."""
        jacobian = self.jacobian(u, central=True)
        here = self.at(u)
        step = np.linalg.lstsq(jacobian, -here, rcond=1e-10)[0]
        better = self.coordinates.clipped(u + step)
        if np.abs(step).max() < 0.05:
            there = self.at(better)
            if np.isfinite(there).all() and there @ there < here @ here:
                return better, jacobian
        return u, jacobian

    def described(
        self,
        u: Vector,
        jacobian: Vector,
        before: Sequence[Predicted | str],
        after: Sequence[Predicted | str],
    ) -> Fit:
        """Return values with their uncertainty, from the derivatives at the solution."""
        residual = self.residuals.weighted(after)
        free = max(1, self.residuals.count - len(u))
        chi = float(residual @ residual) / free
        inflation = 1.0
        if chi > _MISFIT:
            inflation = chi * correlation_time(self.residuals.blocks(after))
        covariance, undetermined = uncertainty(
            jacobian, inflation, [p.name for p in self.parameters]
        )
        errors = np.sqrt(np.diag(covariance))
        with np.errstate(invalid="ignore"):
            correlations = covariance / np.outer(errors, errors)
        correlations[~np.isfinite(correlations)] = 0.0
        np.fill_diagonal(correlations, 1.0)
        reach = stats.t.ppf(0.975, free) * errors
        intervals = np.column_stack([u - reach, u + reach]) * self.size[:, None]
        return Fit(
            self.parameters,
            self.start,
            u * self.size,
            errors * self.size,
            intervals,
            correlations,
            undetermined,
            self.residuals.rms(before),
            self.residuals.rms(after),
            before,
            after,
            chi,
            inflation,
        )


def uncertainty(
    jacobian: Vector, inflation: float, names: Sequence[str]
) -> tuple[Vector, list[Combination]]:
    """Return the covariance of the parameters and the combinations that are not determined.

    Parameters
    ----------
    jacobian : ndarray, shape (n, p)
        Of residuals in units of their noise, by parameters in their sizes.
    inflation : float
        Factor of the variances.
    names : sequence of str
    """
    _, singular, rows = np.linalg.svd(jacobian, full_matrices=False)
    dead = singular <= 1e-9 * max(float(singular.max(initial=0.0)), 1e-300)
    with np.errstate(divide="ignore"):
        spread = np.where(dead, np.inf, np.sqrt(inflation) / np.where(dead, 1.0, singular))
    covariance = np.zeros((len(names), len(names)))
    for deviation, direction in zip(spread, rows, strict=True):
        if np.isfinite(deviation):
            covariance += deviation**2 * np.outer(direction, direction)
    for direction in rows[dead]:
        for k in np.flatnonzero(np.abs(direction) > 1e-6):
            covariance[k, k] = np.inf
    found = []
    for deviation, direction in zip(spread, rows, strict=True):
        if deviation < _LOOSE:
            continue
        share = direction / direction[np.abs(direction).argmax()]
        named = {n: float(s) for n, s in zip(names, share, strict=True) if abs(s) >= _NAMED}
        found.append(Combination(named, float(deviation)))
    return covariance, found


def correlation_time(blocks: Sequence[Mapping[str, Vector]]) -> float:
    """Return how many successive residuals count as one: what the model misses is no noise.

    The integrated autocorrelation, up to its first zero, weighted by sums of squares.
    """
    total = weight = 0.0
    for block in blocks:
        for rows in block.values():
            for column in rows.T:
                power = float(column @ column)
                if power <= 0.0 or len(column) < 4:
                    continue
                n = 2 * len(column)
                spectrum = np.abs(np.fft.rfft(column, n)) ** 2
                lags = np.fft.irfft(spectrum, n)[: len(column) // 2] / power
                ends = np.flatnonzero(lags <= 0.0)
                last = int(ends[0]) if len(ends) else len(lags)
                total += power * (1.0 + 2.0 * float(lags[1:last].sum()))
                weight += power
    return max(1.0, total / weight) if weight else 1.0
