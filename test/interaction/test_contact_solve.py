# SPDX-License-Identifier: Apache-2.0
"""The bounded problem: against other solvers, from any start, at degenerate bounds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear, minimize

from needle_sim_ros import SolverError
from needle_sim_ros.interaction import contact_solve
from needle_sim_ros.interaction.contact_solve import solve_contact
from needle_sim_ros.needle.beam import flexibility


def random_problem(seed, size, conditioning=3.0):
    """A random SPD matrix; equality-like, one-sided, two-sided and closed bounds mixed."""
    rng = np.random.default_rng(seed)
    vectors, _ = np.linalg.qr(rng.normal(size=(size, size)))
    matrix = (vectors * 10 ** rng.uniform(-conditioning, 0, size)) @ vectors.T
    matrix = 0.5 * (matrix + matrix.T)
    right = rng.normal(size=size)
    free = np.linalg.solve(matrix, right)
    width = np.abs(free) * rng.uniform(0, 1.5, size)
    low = np.where(rng.random(size) < 0.3, -np.inf, -width)
    high = np.where(rng.random(size) < 0.3, np.inf, width)
    closed = rng.random(size) < 0.1
    low[closed] = high[closed] = 0.1
    return matrix, right, low, high


def assert_solves(found, matrix, right, low, high, tolerance=1e-8):
    """Karush-Kuhn-Tucker: feasible; the gradient nought inside, outward at the bounds."""
    x, gradient = found.x, matrix @ found.x - right
    scale = np.abs(right).max()
    assert (x >= low).all() and (x <= high).all()
    inside = (x > low) & (x < high)
    assert np.abs(gradient[inside]).max(initial=0) <= tolerance * scale
    assert gradient[(x <= low) & (low < high)].min(initial=0) >= -tolerance * scale
    assert gradient[(x >= high) & (low < high)].max(initial=0) <= tolerance * scale
    np.testing.assert_allclose(found.gradient, gradient, atol=tolerance * scale)


problems = st.builds(random_problem, st.integers(0, 10**6), st.integers(1, 40))


@given(problem=problems, seed=st.integers(0, 10**6))
@settings(max_examples=150)
def test_optimality_from_any_start(problem, seed):
    matrix, right, low, high = problem
    start = np.random.default_rng(seed).integers(-1, 2, len(right)).astype(np.int8)
    start[(start < 0) & np.isinf(low)] = 0
    start[(start > 0) & np.isinf(high)] = 0
    cold = solve_contact(matrix, right, low, high, np.zeros(len(right), dtype=np.int8))
    warm = solve_contact(matrix, right, low, high, start)
    assert_solves(cold, matrix, right, low, high)
    assert_solves(warm, matrix, right, low, high)
    np.testing.assert_allclose(warm.x, cold.x, atol=1e-6 * max(1.0, np.abs(cold.x).max()))


@given(problem=problems)
@settings(max_examples=40)
def test_against_bounded_least_squares(problem):
    """min |R x - R^-T b|^2 with A = R^T R has the same minimiser (scipy's lsq_linear)."""
    matrix, right, low, high = problem
    root = cholesky(matrix)
    load = solve_triangular(root, right, trans="T")
    found = solve_contact(matrix, right, low, high, np.zeros(len(right), dtype=np.int8))
    wider = np.where(low == high, high + 1e-9, high)  # lsq_linear wants low < high
    other = lsq_linear(root, load, (low, wider), method="trf", tol=1e-14, lsmr_tol="auto")
    np.testing.assert_allclose(found.x, other.x, atol=1e-4 * max(1.0, np.abs(other.x).max()))
    # and it is no worse a minimiser
    cost = [0.5 * np.sum((root @ x - load) ** 2) for x in (found.x, np.clip(other.x, low, high))]
    assert cost[0] <= cost[1] * (1 + 1e-9) + 1e-12


@given(problem=st.builds(random_problem, st.integers(0, 10**6), st.integers(1, 15), st.just(1.5)))
@settings(max_examples=25)
def test_against_a_quasi_newton_method(problem):
    """scipy's L-BFGS-B on the objective itself."""
    matrix, right, low, high = problem
    other = minimize(
        lambda x: (0.5 * x @ matrix @ x - right @ x, matrix @ x - right),
        np.clip(np.zeros(len(right)), low, high),
        jac=True,
        bounds=np.column_stack([low, high]),
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 5000},
    )
    found = solve_contact(matrix, right, low, high, np.zeros(len(right), dtype=np.int8))
    np.testing.assert_allclose(found.x, other.x, atol=2e-4 * max(1.0, np.abs(other.x).max()))


def test_two_by_two_by_hand():
    """A = [[2, 1], [1, 2]], b = (4, 1): free (7/3, -2/3); with x2 >= 0 x = (2, 0), g2 = 1."""
    matrix, right = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([4.0, 1.0])
    none = np.full(2, np.inf)
    free = solve_contact(matrix, right, -none, none, np.zeros(2, dtype=np.int8))
    assert free.x == pytest.approx([7 / 3, -2 / 3])
    assert free.status.tolist() == [0, 0]
    bounded = solve_contact(
        matrix, right, np.array([-np.inf, 0.0]), none, np.zeros(2, dtype=np.int8)
    )
    assert bounded.x == pytest.approx([2.0, 0.0])
    assert bounded.gradient == pytest.approx([0.0, 1.0])
    assert bounded.status.tolist() == [0, -1]


def test_closed_bounds_hold_everything():
    """low == high for all: nothing to solve, the gradient is what the bounds carry."""
    matrix, right, *_ = random_problem(5, 12)
    values = np.linspace(-1, 1, 12)
    found = solve_contact(matrix, right, values, values, np.zeros(12, dtype=np.int8))
    np.testing.assert_array_equal(found.x, values)
    np.testing.assert_allclose(found.gradient, matrix @ values - right, atol=1e-12)


def test_no_load_no_force():
    found = solve_contact(
        np.eye(3), np.zeros(3), -np.ones(3), np.ones(3), np.ones(3, dtype=np.int8)
    )
    np.testing.assert_allclose(found.x, 0.0, atol=1e-15)


@pytest.mark.parametrize("matrix", [-np.eye(3), np.zeros((3, 3)), np.ones((3, 3)) - np.eye(3)])
def test_an_indefinite_matrix_is_refused(matrix):
    infinite = np.full(3, np.inf)
    with pytest.raises(SolverError, match="positive definite"):
        solve_contact(matrix, np.ones(3), -infinite, infinite, np.zeros(3, dtype=np.int8))


def contact_like(count, seed):
    """A needle in a Winkler bed: lateral rows without bounds, friction and tip with.

    The tissue's compliance falls off with distance as log-like kernels do, friction has
    equal bounds as in sliding, and the load is that of a hold: everything at its bound is
    about to let go a little.
    """
    rng = np.random.default_rng(seed)
    at = 0.13 - 0.06 + 1e-3 * np.arange(count)
    distance = np.abs(at[:, None] - at[None, :])
    tissue = 5e-3 * np.exp(-distance / 0.01) + 2e-3 * np.eye(count)
    cross = 0.2 * tissue
    matrix = np.block(
        [
            [tissue + flexibility(at, at, 1.65e-3), cross],
            [cross.T, tissue + 1e-3 * np.eye(count)],
        ]
    )
    bound = np.full(count, 1.4e-2)
    inner = np.clip(bound * rng.choice([1.0, 1.0, 0.98, -1.0], count), -bound, bound)
    lateral = 1e-3 * rng.normal(size=count)
    right = matrix @ np.concatenate([lateral, inner]) + 1e-7 * rng.normal(size=2 * count)
    low = np.concatenate([np.full(count, -np.inf), -bound])
    status = np.concatenate([np.zeros(count), np.sign(inner)]).astype(np.int8)
    return matrix, right, low, -low, status


@pytest.mark.parametrize("seed", range(20))
def test_it_ends_at_the_start_of_a_hold(seed):
    """Where a plain active-set loop cycles: everything near a bound, wrong guesses too."""
    matrix, right, low, high, status = contact_like(60, seed)
    from_there = solve_contact(matrix, right, low, high, status)
    against = solve_contact(matrix, right, low, high, -status)
    assert_solves(from_there, matrix, right, low, high)
    assert max(from_there.iterations, against.iterations) < 40
    np.testing.assert_allclose(against.x, from_there.x, atol=1e-9)


def test_a_good_guess_takes_one_solve():
    matrix, right, low, high, status = contact_like(60, 3)
    first = solve_contact(matrix, right, low, high, status)
    again = solve_contact(matrix, right, low, high, first.status)
    assert again.iterations == 1
    np.testing.assert_allclose(again.x, first.x, atol=1e-12)


hard = st.builds(
    random_problem, st.integers(0, 10**6), st.integers(1, 60), st.sampled_from([3.0, 6.0, 9.0])
)


def _descended(problem, allowed):
    start = np.zeros(len(problem.right), dtype=np.int8)
    return contact_solve._descended(problem, start, allowed * np.abs(problem.right).max(), 0)


def _pivoted(problem, allowed):
    return contact_solve._pivoted(problem, allowed, 0)


@pytest.mark.parametrize("fallback", [_descended, _pivoted])
@given(problem=hard)
@settings(max_examples=60)
def test_the_fallbacks_solve_the_same_problem(fallback, problem):
    """What takes over when exchanges, and Newton's steps, stall; ill-conditioned ones too."""
    matrix, right, low, high = problem
    found = fallback(contact_solve._Problem(*problem), 1e-10)
    noise = 1e-15 * np.abs(found.x).sum() / np.abs(right).max()
    assert_solves(found, matrix, right, low, high, tolerance=1e-8 + 10 * noise)


@given(problem=hard)
@settings(max_examples=60)
def test_ill_conditioned_problems(problem):
    """The gradient falls to what rounding leaves of it, at condition numbers up to 1e9."""
    matrix, right, low, high = problem
    found = solve_contact(matrix, right, low, high, np.zeros(len(right), dtype=np.int8))
    noise = 1e-15 * np.abs(found.x).sum() / np.abs(right).max()
    assert_solves(found, matrix, right, low, high, tolerance=1e-8 + 10 * noise)


@pytest.mark.parametrize("steps", [50, 0])
def test_the_fallbacks_take_over(monkeypatch, steps):
    """With no exchanges, and no Newton steps, allowed the answer is still the answer."""
    matrix, right, low, high, status = contact_like(30, 1)
    usual = solve_contact(matrix, right, low, high, status)
    monkeypatch.setattr(contact_solve, "_exchanged", lambda *_: 0)
    monkeypatch.setattr(contact_solve, "_MOST_ITERATIONS", steps)
    other = solve_contact(matrix, right, low, high, status)
    np.testing.assert_allclose(other.x, usual.x, atol=1e-8 * np.abs(usual.x).max())
    np.testing.assert_array_equal(other.status, usual.status)
