# SPDX-License-Identifier: Apache-2.0
"""The sums of a step of reduced dynamics, compiled where there is a compiler.

The rule of a step is linear in what it starts from: a tick does each of these once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from needle_sim_ros import compiled
from needle_sim_ros.geometry import Vector
from needle_sim_ros.tissue.dynamics import flushed

try:
    from needle_sim_ros.tissue import _modal
except ImportError:  # built without a compiler, or run from the source
    _modal = None  # type: ignore[assignment]

_COMPILED = _modal is not None and compiled.wanted()


class Coefficients(NamedTuple):
    """A rule, linear in the state, as numbers.

    Attributes
    ----------
    carry : ndarray, shape (3, m)
        Modal displacement at the end without load is the sum of these of the old u, v, a.
    rates : ndarray, shape (2, 4)
        Velocity and acceleration are these of the old u, v, a and the new u.
    filtered, forces : float
        The filter keeps so much of itself, and takes so much of the last forces.
    """

    carry: Vector
    rates: Vector
    filtered: float
    forces: float


def unloaded(
    rule: Coefficients, modal: Vector, filtered: Vector, forces: Vector
) -> tuple[Vector, Vector]:
    """Return modal displacement (m,) and filtered forces (n, d) at the end, without load.

    Parameters
    ----------
    rule : Coefficients
    modal : ndarray, shape (3, m)
        Modal displacement, velocity, acceleration.
    filtered, forces : ndarray, shape (n, d)
        Filtered and last forces, N.
    """
    if not _COMPILED:
        u = (rule.carry * modal).sum(axis=0)
        return u, rule.filtered * filtered + rule.forces * forces
    u, after = np.empty(modal.shape[1]), np.empty_like(filtered)
    _modal.unloaded_into(rule.carry, modal, filtered, forces, rule.filtered, rule.forces, u, after)
    return u, after


def moved(static: Vector, shapes: Vector, filtered: Vector, u: Vector) -> Vector:
    """Return displacements (r,) by static forces and modes.

    Parameters
    ----------
    static : ndarray, shape (r, n d)
        Per static force, m/N; forces that are not given are zero.
    shapes : ndarray, shape (m, r)
        Of the modes where the displacements are.
    filtered : ndarray, shape (k, d)
        Static forces, N.
    u : ndarray, shape (m,)
        Modal displacement.
    """
    if not _COMPILED:
        flat = filtered.ravel()[: static.shape[1]]
        return np.asarray(static[:, : len(flat)] @ flat + shapes.T @ u)
    out = np.empty(len(static))
    _modal.moved_into(static, shapes, filtered, u, out)
    return out


def loaded(
    rule: Coefficients,
    dynamic: Vector,
    share: float,
    shapes: Vector,
    forces: Vector,
    begun: tuple[Vector, Vector, Vector],
) -> tuple[Vector, Vector]:
    """Return modal state (3, m) and filtered forces (n, d) at the end of a step.

    Parameters
    ----------
    rule : Coefficients
    dynamic : ndarray, shape (m,)
        Modal displacement per modal force.
    share : float
        Of new forces that the filter takes.
    shapes : ndarray, shape (m, n d)
        Of the modes where forces act.
    forces : ndarray, shape (n, d)
        N.
    begun : tuple of ndarray
        Modal state before the step, (3, m); displacement (m,) and filtered forces (k, d) at
        its end without load.
    """
    modal, u, filtered = begun
    if not _COMPILED:
        whole = np.vstack([modal, dynamic * (shapes @ forces.ravel()) + u])
        known = filtered[: len(forces)]
        taken = share * forces
        taken[: len(known)] += known
        return flushed(np.vstack([whole[3], rule.rates @ whole])), flushed(taken)
    after, taken = np.empty_like(modal), np.empty_like(forces)
    _modal.loaded_into(dynamic, shapes, forces, u, modal, rule.rates, share, filtered, after, taken)
    return after, taken
