# SPDX-License-Identifier: Apache-2.0
"""The cantilever against closed forms, against a finite-element beam, and against Eq. (6)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_sim_ros.needle.beam import flexibility, tip_slope_flexibility

LENGTH, RIGIDITY = 0.13, 2.1e9 * 0.7854e-12
ARCLENGTHS = st.lists(st.floats(1e-4, 0.2), min_size=1, max_size=12).map(np.array)


def at(*arclengths):
    return np.array(arclengths)


def test_tip_load():
    """F L^3 / 3 E I."""
    exact = LENGTH**3 / (3 * RIGIDITY)
    assert flexibility(at(LENGTH), at(LENGTH), RIGIDITY)[0, 0] == pytest.approx(exact, rel=1e-14)


def test_deflection_between_clamp_and_load():
    """w(x) = x^2 (3 a - x) / 6 E I for x <= a; at x = L/2, a = L: 5 L^3 / 48 E I."""
    exact = 5 * LENGTH**3 / (48 * RIGIDITY)
    found = flexibility(at(LENGTH / 2), at(LENGTH), RIGIDITY)[0, 0]
    assert found == pytest.approx(exact, rel=1e-14)


def test_needle_beyond_the_load_is_straight():
    """Beyond a load at a the beam carries no moment: w(x) = a^3/3EI + (x - a) a^2/2EI."""
    a, x = 0.05, np.array([0.05, 0.08, 0.13, 0.15])
    exact = a**3 / (3 * RIGIDITY) + (x - a) * a**2 / (2 * RIGIDITY)
    np.testing.assert_allclose(flexibility(x, at(a), RIGIDITY)[:, 0], exact, rtol=1e-13)


def test_slope_at_the_tip():
    """L^2 / 2 E I under a tip load, a^2 / 2 E I under a load at a."""
    slopes = tip_slope_flexibility(at(LENGTH, 0.05), RIGIDITY)
    np.testing.assert_allclose(slopes, np.array([LENGTH, 0.05]) ** 2 / (2 * RIGIDITY), rtol=1e-14)


@given(loads=ARCLENGTHS)
@settings(max_examples=50)
def test_slope_is_the_derivative_of_the_deflection(loads):
    """Central difference of the deflection about the tip, beyond all loads."""
    step, tip = 1e-6, at(0.25)
    ahead, behind = (
        flexibility(tip + step, loads, RIGIDITY),
        flexibility(tip - step, loads, RIGIDITY),
    )
    np.testing.assert_allclose(
        (ahead - behind)[0] / (2 * step),
        tip_slope_flexibility(loads, RIGIDITY),
        atol=1e-8 * LENGTH**2 / RIGIDITY,
    )


def test_clamp_does_not_move_and_who_pushes_it_turns_nothing():
    assert flexibility(at(0.0), at(0.1), RIGIDITY)[0, 0] == 0.0
    assert tip_slope_flexibility(at(0.0), RIGIDITY)[0] == 0.0


@given(places=ARCLENGTHS)
@settings(max_examples=50)
def test_maxwell_betti(places):
    """The deflection at i under a force at j is the one at j under a force at i."""
    matrix = flexibility(places, places, RIGIDITY)
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-12)


@given(places=st.lists(st.integers(1, 400), min_size=1, max_size=30, unique=True))
@settings(max_examples=50)
def test_any_loads_do_positive_work(places):
    matrix = flexibility(np.array(places) * 5e-4, np.array(places) * 5e-4, 1.0)
    scaled = matrix / np.sqrt(np.outer(matrix.diagonal(), matrix.diagonal()))
    assert np.linalg.eigvalsh(scaled)[0] > -1e-13


def beam_elements(nodes, loads, rigidity):
    """Deflections of a chain of Hermite beam elements, clamped at 0; exact at its nodes."""
    ends = np.concatenate([[0.0], nodes])
    stiffness = np.zeros((2 * len(ends), 2 * len(ends)))
    for i, h in enumerate(np.diff(ends)):
        block = np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
        stiffness[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += rigidity / h**3 * block
    forces = np.zeros(2 * len(ends))
    forces[2::2] = loads
    return np.concatenate([[0, 0], np.linalg.solve(stiffness[2:, 2:], forces[2:])])[2::2]


def test_against_beam_elements():
    """Cubic beam elements give the exact deflection at nodes under nodal forces."""
    rng = np.random.default_rng(1)
    nodes = np.sort(rng.uniform(0.005, LENGTH, 20))
    loads = rng.normal(size=20)
    expected = beam_elements(nodes, loads, RIGIDITY)
    found = flexibility(nodes, nodes, RIGIDITY) @ loads
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def printed_equation_6(nodes, loads, rigidity):
    """Eq. (6) as printed, l_i read as the distance of node i to the support."""
    k = nodes**3 / (3 * rigidity)
    beyond = np.cumsum(loads[::-1])[::-1]
    return np.array(
        [
            k[i] * beyond[i]
            + sum((nodes[i] - nodes[j]) * 1.5 * k[j] / nodes[j] * beyond[j] for j in range(i))
            for i in range(len(nodes))
        ]
    )


@pytest.mark.parametrize("count", [2, 10, 60])
def test_equation_6_as_printed_is_not_a_beam(count):
    """Under a tip load it gives 1 + (n^2 - 1) / 8n times the exact deflection, n nodes."""
    nodes = LENGTH * np.arange(1, count + 1) / count
    loads = np.zeros(count)
    loads[-1] = 1.0
    exact = flexibility(nodes, nodes, RIGIDITY) @ loads
    ratio = printed_equation_6(nodes, loads, RIGIDITY)[-1] / exact[-1]
    assert ratio == pytest.approx(1 + (count**2 - 1) / (8 * count), rel=1e-12)
    units = [printed_equation_6(nodes, unit, RIGIDITY) for unit in np.eye(count)]
    matrix = np.array(units).T
    assert np.abs(matrix - matrix.T).max() > 0.05 * matrix.max()
