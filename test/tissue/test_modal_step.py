# SPDX-License-Identifier: Apache-2.0
"""The sums of a step of reduced dynamics: by the formulas written out, compiled and by numpy."""

import numpy as np
import pytest

from needle_sim_ros.tissue import modal_step
from needle_sim_ros.tissue.modal_step import Coefficients, loaded, moved, unloaded

MODES, ROWS, D = 6, 5, 2
RNG = np.random.default_rng(11)
RULE = Coefficients(RNG.normal(size=(3, MODES)), RNG.normal(size=(2, 4)), 0.7, 0.2)
STATE = RNG.normal(size=(3, MODES))
FILTERED, FORCES = RNG.normal(size=(ROWS, D)), RNG.normal(size=(ROWS, D))
# parts of larger stores, as tables have them
STATIC = RNG.normal(size=(40, 40))[: ROWS * D, : ROWS * D]
SHAPES = RNG.normal(size=(MODES, 40))[:, : ROWS * D]


@pytest.fixture(params=[True, False], ids=["compiled", "numpy"], autouse=True)
def either(request, monkeypatch):
    if request.param and modal_step._modal is None:
        pytest.skip("built without a compiler")
    monkeypatch.setattr(modal_step, "_COMPILED", request.param)


def test_without_load_the_state_is_carried_on():
    u, filtered = unloaded(RULE, STATE, FILTERED, FORCES)
    for i in range(MODES):
        expected = sum(RULE.carry[k, i] * STATE[k, i] for k in range(3))
        assert u[i] == pytest.approx(expected, rel=1e-13, abs=1e-15)
    np.testing.assert_allclose(filtered, 0.7 * FILTERED + 0.2 * FORCES, rtol=1e-14)


@pytest.mark.parametrize("known", [0, 3, ROWS, ROWS + 2], ids=["none", "some", "all", "more"])
def test_forces_that_are_not_given_are_zero_and_more_do_not_count(known):
    given = RNG.normal(size=(known, D))
    u = RNG.normal(size=MODES)
    wide = np.zeros((ROWS, D))
    wide[:known] = given[:ROWS]
    expected = np.einsum("ij,j->i", STATIC, wide.ravel()) + np.einsum("mi,m->i", SHAPES, u)
    np.testing.assert_allclose(moved(STATIC, SHAPES, given, u), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("known", [0, 3, ROWS], ids=["none", "some", "all"])
def test_loaded_ends_a_step(known):
    u, dynamic, share = RNG.normal(size=MODES), RNG.uniform(1, 2, MODES), 0.4
    kept = FILTERED[:known]
    modal, filtered = loaded(RULE, dynamic, share, SHAPES, FORCES, (STATE, u, kept))
    for i in range(MODES):
        reached = u[i] + dynamic[i] * (SHAPES[i] @ FORCES.ravel())
        whole = np.array([*STATE[:, i], reached])
        expected = [reached, RULE.rates[0] @ whole, RULE.rates[1] @ whole]
        np.testing.assert_allclose(modal[:, i], expected, rtol=0, atol=1e-13)
    wide = np.zeros((ROWS, D))
    wide[:known] = kept
    np.testing.assert_allclose(filtered, share * FORCES + wide, rtol=0, atol=1e-15)


def test_nothing_becomes_subnormal():
    """Motion that has died away is zero: subnormal numbers are several times slower."""
    tiny, u = np.full((3, MODES), 1e-290), np.zeros(MODES)
    nothing = np.zeros((ROWS, D))
    modal, filtered = loaded(RULE, u, 1.0, SHAPES, nothing, (tiny, u, nothing + 1e-290))
    assert not modal.any()
    assert not filtered.any()


def test_no_tissue_needs_no_rows():
    none = np.empty((0, D))
    out = moved(np.empty((0, 0)), np.empty((MODES, 0)), none, np.ones(MODES))
    assert out.shape == (0,)


@pytest.mark.parametrize(
    "arguments",
    [
        (STATIC, SHAPES[:, :4], FILTERED, STATE[0]),
        (STATIC, SHAPES[:3], FILTERED, STATE[0]),
        (STATIC.T, SHAPES, FILTERED, STATE[0]),
        (STATIC.astype(np.float32), SHAPES, FILTERED, STATE[0]),
    ],
    ids=["rows", "modes", "turned", "floats"],
)
def test_what_does_not_fit_is_refused(arguments):
    if modal_step._modal is None:
        pytest.skip("built without a compiler")
    with pytest.raises(ValueError, match=r"fit|row by row"):
        modal_step._modal.moved_into(*arguments, np.empty(ROWS * D))
