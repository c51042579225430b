# SPDX-License-Identifier: Apache-2.0
"""Sums of products by compiled code: what numpy finds, whatever the layout."""

import numpy as np
import pytest

from needle_sim_ros.tissue import products
from needle_sim_ros.tissue.products import product, samples, weighted_rows

RNG = np.random.default_rng(5)
STORE = RNG.normal(size=(64, 96))


@pytest.mark.parametrize(
    "matrix",
    [
        STORE,
        STORE[:7, :40],
        STORE[:40, :7].T,
        STORE[::2, ::3],
        STORE[:1, :5],
        STORE[:5, :1],
        STORE[:5, :1].T,
        np.asfortranarray(STORE),
    ],
    ids=["whole", "part", "turned", "every other", "one row", "one column", "turned column", "F"],
)
def test_it_is_what_numpy_finds(matrix):
    vector = RNG.normal(size=matrix.shape[1])
    expected = matrix @ vector
    found = product(matrix, vector)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(matrix).sum())


@pytest.mark.parametrize("shape", [(0, 4), (4, 0), (0, 0)])
def test_nothing_gives_zeros(shape):
    found = product(np.empty(shape), np.ones(shape[1]))
    np.testing.assert_array_equal(found, np.zeros(shape[0]))


@pytest.mark.parametrize(
    ("matrix", "vector"),
    [
        (np.ones((3, 4)), np.ones(3)),
        (np.ones((3, 4)), np.ones((4, 1))),
        (np.ones(4), np.ones(4)),
        (np.ones((3, 4), dtype=np.float32), np.ones(4)),
    ],
)
def test_what_does_not_fit_is_refused(matrix, vector):
    if products._products is None:
        pytest.skip("built without a compiler")
    with pytest.raises(ValueError, match=r"times|dimensions"):
        products._products.product_into(matrix, vector, np.empty(3))


@pytest.fixture(params=[True, False], ids=["compiled", "numpy"])
def either(request, monkeypatch):
    if request.param and products._products is None:
        pytest.skip("built without a compiler")
    monkeypatch.setattr(products, "_COMPILED", request.param)


@pytest.mark.parametrize("matrix", [STORE, STORE.T, STORE[::2, ::3]], ids=["C", "F", "strided"])
def test_rows_are_added_up_with_their_weights(either, matrix):
    rows, weights = np.array([5, 0, 31, 5]), np.array([0.5, -2.0, 3.0, 0.25])
    found = weighted_rows(matrix, rows, weights, 3, 20)
    expected = sum(w * matrix[r, 3:20] for r, w in zip(rows, weights, strict=True))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_a_column_of_the_sum_does_not_hang_on_what_else_is_asked_for(either):
    rows, weights = RNG.integers(0, 64, 40), RNG.normal(size=40)
    whole = weighted_rows(STORE, rows, weights, 0, 96)
    np.testing.assert_array_equal(weighted_rows(STORE, rows, weights, 7, 12), whole[7:12])


def test_no_rows_add_up_to_zero(either):
    none = np.empty(0, dtype=np.intp)
    np.testing.assert_array_equal(weighted_rows(STORE, none, np.empty(0), 2, 5), np.zeros(3))


@pytest.mark.parametrize("wide", [1, 2, 3])
def test_a_field_is_sampled_group_by_group(either, wide):
    field = RNG.normal(size=(30, wide))
    places, weights = RNG.integers(0, 30, 12), RNG.normal(size=12)
    starts = np.array([0, 1, 5])
    found = samples(field.ravel(), places, weights, starts, wide)
    each = weights[:, None] * field[places]
    expected = np.concatenate([each[:1].sum(0), each[1:5].sum(0), each[5:].sum(0)])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("rows", "low", "message"),
    [([0, 64], 0, "row 64 of 64"), ([-1], 0, "row -1 of 64"), ([0], 90, "columns 90 to 100 of 96")],
)
def test_rows_and_columns_that_are_not_there_are_refused(rows, low, message):
    if products._products is None:
        pytest.skip("built without a compiler")
    weights = np.ones(len(rows))
    with pytest.raises(ValueError, match=message):
        products._products.rows_into(STORE, np.array(rows), weights, low, np.empty(10))


@pytest.mark.parametrize(
    ("places", "starts", "message"),
    [
        ([30], [0], "place 30 of 30"),
        ([-1], [0], "place -1"),
        ([1, 2], [0, 3], "places 0 to 3 of 2"),
    ],
)
def test_places_that_are_not_there_are_refused(places, starts, message):
    if products._products is None:
        pytest.skip("built without a compiler")
    out = np.empty(2 * len(starts))
    with pytest.raises(ValueError, match=message):
        products._products.samples_into(
            np.ones(60), np.array(places), np.ones(len(places)), np.array(starts), out
        )
