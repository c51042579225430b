# SPDX-License-Identifier: Apache-2.0
"""Reduced dynamics against full Newmark."""

import itertools

import numpy as np
import pytest

from needle_sim_ros.tissue.reduced import lowest_modes

PUSH = np.array([[0.0, -0.1], [0.02, -0.05]])  # per row: x, z
DAMPED = {"tissue.damping": {"alpha": 0.0, "beta": 5e-3}, "solver.time_step": 5e-3}


def history(tissue, forces):
    """Displacements of the rows after each step, (steps, 2, 2)."""
    states = tissue.steps(forces)
    return np.array([tissue.rows(s, f) for s, f in zip(states, forces, strict=True)])


def sudden(steps=60):
    """A load that comes at once and goes at once."""
    return [PUSH] * (2 * steps // 3) + [0 * PUSH] * (steps // 3)


def test_modes_are_normal_and_ordered(loaded):
    tissue = loaded({"solver.modes": 20})
    values, shapes = lowest_modes(tissue.model, tissue.dynamics._factor, 20)
    assert (np.diff(values) >= 0).all() and values[0] > 0
    model = tissue.model
    np.testing.assert_allclose(shapes.T @ (model.mass @ shapes), np.eye(20), atol=1e-9)
    stiffness = shapes.T @ (model.stiffness @ shapes)
    np.testing.assert_allclose(stiffness, np.diag(values), atol=1e-8 * values[-1])


@pytest.mark.parametrize("damping", [{"alpha": 0.0, "beta": 0.0}, {"alpha": 1.0, "beta": 0.0}])
def test_with_all_modes_it_is_full_newmark(loaded, damping):
    """All modes but the two that the eigensolver leaves: nothing is left to be massless."""
    changes = {"tissue.damping": damping, "solver.time_step": 5e-3}
    full, reduced = loaded(changes), loaded({**changes, "solver.modes": 2000})
    assert len(reduced.dynamics.eigenvalues) == len(full.model.free) - 2
    exact = history(full, sudden())
    np.testing.assert_allclose(history(reduced, sudden()), exact, atol=1e-5 * np.abs(exact).max())


@pytest.mark.parametrize(("modes", "error"), [(10, 0.03), (40, 0.006)])
def test_a_sudden_load(loaded, modes, error):
    """With the tissue's damping: of the largest displacement, at any step and row."""
    full, reduced = loaded(DAMPED), loaded({**DAMPED, "solver.modes": modes})
    exact = history(full, sudden())
    found = history(reduced, sudden())
    assert np.abs(found - exact).max() < error * np.abs(exact).max()


def test_more_modes_are_better(loaded):
    exact = history(loaded(DAMPED), sudden())
    misses = [
        np.linalg.norm(history(loaded({**DAMPED, "solver.modes": n}), sudden()) - exact)
        for n in (4, 16, 64)
    ]
    assert misses[0] > misses[1] > misses[2]


def test_a_steady_load_ends_in_equilibrium(loaded):
    """Whatever the number of modes, the static answer is kept whole."""
    changes = {"tissue.damping": {"alpha": 5.0, "beta": 0.02}, "solver.time_step": 0.02}
    still = loaded({"solver.dynamics": "quasi_static"})
    tissue = loaded({**changes, "solver.modes": 3})
    *_, last = tissue.steps(itertools.repeat(PUSH, 400))
    np.testing.assert_allclose(
        tissue.rows(last, PUSH), still.rows(None, PUSH), rtol=1e-6, atol=1e-12
    )


def test_motion_that_dies_away_leaves_no_subnormal_numbers(loaded):
    """Processors count several times slower with them; a tick took four times as long."""
    tissue = loaded({**DAMPED, "solver.modes": 20})
    forces = [PUSH] * 10 + [0 * PUSH] * 1500
    smallest = np.finfo(float).tiny
    for state in tissue.steps(forces):
        for values in (state.modal, state.filtered):
            size = np.abs(values)
            assert not ((size > 0) & (size < smallest)).any()
    assert not state.filtered.any()
