# SPDX-License-Identifier: Apache-2.0
"""Products of matrix and vector by compiled code: what numpy finds, whatever the layout."""

import numpy as np
import pytest

from needle_sim_ros.tissue import products
from needle_sim_ros.tissue.products import product

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
