# SPDX-License-Identifier: Apache-2.0
"""Lateral forces by a factor of before: as by the whole matrix of now."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_sim_ros.errors import SolverError
from needle_sim_ros.geometry import from_rotation_vector
from needle_sim_ros.interaction.lateral_hold import LateralHold, bending
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.needle.beam import flexibility
from needle_sim_ros.tissue.response import ResponseRow, ResponseTable, Rows

K, SPACING, RIGIDITY = 9, 2e-3, 1.6e-3
PLACES = 0.05 + SPACING * np.arange(K)


class Tissue:
    """What a response table asks of a compliance."""

    readers = 0

    def __init__(self, dimension):
        self.dimension = dimension


def table_of(tissue, compliance, count):
    """A table that holds the first rows of a compliance."""
    table, d = ResponseTable(tissue), tissue.dimension
    for k in range(count):
        static = compliance[: d * (k + 1), d * k : d * (k + 1)]
        rows = Rows()
        table = table.appended(ResponseRow(rows, static, np.empty((0, d)), np.empty((0, d))))
    return table


def compliance_of(dimension, count=K + 2):
    rng = np.random.default_rng(dimension)
    size = dimension * count
    root = rng.standard_normal((size, size))
    return 1e-4 * (root @ root.T + size * np.eye(size)) / size


@pytest.fixture(scope="module", params=[2, 3])
def held(request):
    """Compliance of a tissue, a table of it, and the axes of a base that stands askew."""
    d = request.param
    compliance = compliance_of(d)
    turned = from_rotation_vector(np.array([0.0, 0.3, 0.0]))
    pose = BasePose.of(np.zeros(3), turned, d)
    return compliance, table_of(Tissue(d), compliance, K + 1), pose


def whole(compliance, pose, arclength, softness):
    """The matrix as its definition says, every entry from the beam and the tissue."""
    d, k = len(pose.axial), len(arclength)
    own = compliance[: d * k, : d * k].reshape(k, d, k, d)
    m = d - 1
    matrix = np.einsum("ac,kcle,be->akbl", pose.lateral, own, pose.lateral)
    needle = flexibility(arclength, arclength, RIGIDITY) + np.diag(softness)
    for a in range(m):
        matrix[a, :, a, :] += needle
    return matrix.reshape(m * k, m * k)


@given(
    farther=st.floats(0, SPACING),
    softer=st.lists(st.floats(0, 1e3), min_size=3, max_size=3),
    seed=st.integers(0, 100),
)
def test_a_step_is_solved_as_by_the_whole_matrix(held, farther, softer, seed):
    """For any way of the base and any softness of the last points, to rounding."""
    compliance, table, pose = held
    least = np.zeros(K)
    least[-2:] = 0.01, 0.05
    hold = LateralHold(table, pose.terms, PLACES, least, RIGIDITY, varying=3)
    arclength, softness = PLACES + farther, least.copy()
    softness[-3:] += softer
    gaps = np.random.default_rng(seed).standard_normal(len(pose.lateral) * K)
    expected = np.linalg.solve(whole(compliance, pose, arclength, softness), gaps)
    found = hold.forces(gaps.copy(), arclength, softness)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_what_was_factorised_is_solved_for(held):
    """Without any change, a turning needle's case."""
    compliance, table, pose = held
    soft = np.linspace(0, 0.1, K)
    hold = LateralHold(table, pose.terms, PLACES, soft, RIGIDITY)
    gaps = np.ones(len(pose.lateral) * K)
    expected = np.linalg.solve(whole(compliance, pose, PLACES, soft), gaps)
    np.testing.assert_allclose(hold.forces(gaps, PLACES, soft), expected, rtol=1e-10)


def test_bending_is_the_beam_and_its_hold():
    """On the diagonal and below it."""
    soft = np.linspace(0, 0.1, K)
    expected = flexibility(PLACES, PLACES, RIGIDITY) + np.diag(soft)
    found = bending(PLACES, soft, RIGIDITY)
    np.testing.assert_allclose(np.tril(found), np.tril(expected), rtol=1e-13)


def test_it_serves_what_grew_from_its_table_and_nothing_else(held):
    """Another needle, other axes, more points, another branch of the track: a new one."""
    compliance, table, pose = held
    d = len(pose.axial)
    hold = LateralHold(table, pose.terms, PLACES, np.zeros(K), RIGIDITY)
    assert hold.serves(table, pose.terms, K)
    assert not hold.serves(table, pose.terms, K - 1)
    again = BasePose.of(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), d)
    assert not hold.serves(table, again.terms, K)
    static = compliance[: d * (K + 2), d * (K + 1) : d * (K + 2)]
    row = ResponseRow(Rows(), static, np.empty((0, d)), np.empty((0, d)))
    assert hold.serves(table.appended(row), pose.terms, K)
    assert not hold.serves(table.appended(row), pose.terms, K)  # a branch has rows of its own
    assert not hold.serves(table_of(Tissue(d), compliance, K + 1), pose.terms, K)


def test_a_compliance_that_is_not_positive_definite_is_refused(held):
    _, table, pose = held
    with pytest.raises(SolverError, match="not positive definite"):
        LateralHold(table, pose.terms, PLACES, np.full(K, -1e3), RIGIDITY)
