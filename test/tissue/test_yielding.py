# SPDX-License-Identifier: Apache-2.0
"""How far the tissue has yielded within a step: beta u' + u = C f against scipy's solution."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from needle_sim_ros.tissue.yielding import Yielding

BETA = 5e-3
BEGUN = np.array([[0.3, -1.0], [0.1, 0.2]])

paces = st.floats(0.05, 50.0)


def effective(yielding, share, forces):
    """Return the forces that would displace it as far by the step's compliance."""
    yielded = yielding.to(share)
    return yielded.kept + yielded.part * forces


several = st.lists(st.floats(0.01, 0.9), min_size=1, max_size=6)


@given(paces, st.floats(-3.0, 3.0), several, st.booleans())
def test_what_changes_evenly_is_met_at_once(pace, rise, shares, settling):
    yielding = Yielding(BETA, pace * BETA, BEGUN, (1.0 + rise) * BEGUN, settling)
    for share in sorted(set(shares)):
        forces = (1.0 + share * rise) * BEGUN
        np.testing.assert_allclose(effective(yielding, share, forces), forces, atol=1e-12)
        yielding.took(share, forces)


@given(paces, several)
def test_a_kink_at_the_start_meets_all_at_the_end(pace, shares):
    """Forces that rise evenly from the step's start on, however it is divided."""
    yielding = Yielding(BETA, pace * BETA, BEGUN, BEGUN, False)
    for share in sorted(set(shares)):
        yielding.took(share, (1.0 + share) * BEGUN)
    np.testing.assert_allclose(effective(yielding, 1.0, 2.0 * BEGUN), 2.0 * BEGUN, atol=1e-10)


@given(paces, several)
def test_a_jump_at_the_start_of_a_settling_half_meets_all_at_the_end(pace, shares):
    yielding = Yielding(BETA, pace * BETA, BEGUN, BEGUN, True)
    for share in sorted(set(shares)):
        found = effective(yielding, share, 2.0 * BEGUN) - BEGUN
        exact = np.expm1(-share * pace) / np.expm1(-pace)
        np.testing.assert_allclose(found, exact * BEGUN, atol=1e-10)
        yielding.took(share, 2.0 * BEGUN)
    np.testing.assert_allclose(effective(yielding, 1.0, 2.0 * BEGUN), 2.0 * BEGUN, atol=1e-10)


@pytest.mark.parametrize("pace", [0.2, 2.0, 20.0])
def test_forces_that_go_up_and_down(pace):
    """Deviations from the even course, even between the ends of parts."""
    duration = pace * BETA
    shares, changes = np.array([0.0, 0.1, 0.35, 0.8]), np.array([0.0, 2.0, -1.0, 0.5])
    yielding = Yielding(BETA, duration, BEGUN, BEGUN, False)

    def rate(t, w, ramp=False):
        f = t / duration if ramp else np.interp(t / duration, shares, changes)
        return (f - w) / BETA

    tight = {"rtol": 1e-10, "atol": 1e-13, "max_step": duration / 200}
    whole = solve_ivp(lambda t, w: rate(t, w, True), (0, duration), [0.0], **tight).y[0, -1]
    for share, change in zip(shares[1:], changes[1:], strict=True):
        exact = solve_ivp(rate, (0, share * duration), [0.0], **tight).y[0, -1] / whole
        forces = (1.0 + change) * BEGUN
        found = effective(yielding, share, forces)
        np.testing.assert_allclose(found, (1.0 + exact) * BEGUN, rtol=2e-7)
        yielding.took(share, forces)


@given(st.floats(0.01, 1.0), st.booleans())
def test_without_viscosity_it_yields_at_once(share, settling):
    yielding = Yielding(0.0, 0.01, BEGUN, BEGUN, settling)
    yielding.took(0.5 * share, 3.0 * BEGUN)
    yielded = yielding.to(share)
    assert yielded.part == 1.0
    np.testing.assert_array_equal(yielded.kept, 0.0)
    np.testing.assert_allclose(yielded.acting(2.0 * BEGUN), (1.0 + share) * BEGUN)


def test_rows_come_and_go():
    """A track that grows within the step, and one that is given up."""
    yielding = Yielding(BETA, 0.01, BEGUN[:1], 2.0 * BEGUN[:1], False)
    yielding.took(0.3, 1.5 * BEGUN)
    yielded = yielding.to(0.6)
    assert yielded.kept.shape == (2, 2)
    assert yielded.acting(np.zeros((3, 2))).shape == (3, 2)
    yielding.took(0.6, np.zeros((0, 2)))
    assert np.isfinite(yielding.to(1.0).kept).all()


@pytest.mark.parametrize("share", [1e-17, 1e-9, 0.99e-5, 1.01e-5, 1e-4])
def test_a_moment_meets_little(share):
    """Half of the time that has passed, in relaxation times, of the static compliance."""
    yielding = Yielding(BETA, BETA, BEGUN, BEGUN, False)
    whole = np.exp(-1.0)  # of a ramp over one relaxation time
    assert yielding.to(share).part == pytest.approx(0.5 * share / whole, rel=1e-4)
    yielding.took(share, 2.0 * BEGUN)
    found = effective(yielding, 3.0 * share, BEGUN) - BEGUN
    # what was reached by then, 1 of it, and of what is on the way down, 2 of it
    np.testing.assert_allclose(found, (0.5 + 1.0) * share / whole * BEGUN, rtol=1e-3, atol=1e-15)
