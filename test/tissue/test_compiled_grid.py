# SPDX-License-Identifier: Apache-2.0
"""Shape functions by compiled code: to the bit what numpy finds."""

import numpy as np
import pytest

from needle_sim_ros import compiled
from needle_sim_ros.tissue import compiled_grid
from needle_sim_ros.tissue.model import TissueModel

pytestmark = pytest.mark.skipif(compiled_grid._grid is None, reason="built without a compiler")

TILTED = {"base.orientation": [0.9961947, 0.0, 0.0871557, 0.0]}
DEEP = {
    "dimension": 3,
    "tissue.size": [0.06, 0.06, 0.05],
    "tissue.mesh": {"spacing_across": 6e-3, "spacing_along": 6e-3, "element": "quad1"},
    "solver.track_spacing": 6e-3,
}


LINEAR = {"tissue.mesh.element": "quad1", "tissue.mesh.spacing_along": 2e-3}
SLIGHTLY = {"base.orientation": [0.9998, 0.0, 0.02, 0.0]}


@pytest.fixture(
    params=[{}, TILTED, LINEAR, DEEP, {**DEEP, **SLIGHTLY}],
    ids=["quadratic", "tilted", "linear", "3D", "tilted 3D"],
)
def model(request, coarse_scene):
    return TissueModel(coarse_scene(request.param))


def places(model):
    """Points all over the tissue and about it, on grid lines, and nodes themselves."""
    size = np.array(model.scene.tissue.size)
    rng = np.random.default_rng(7)
    anywhere = rng.uniform(-0.6, 0.6, (300, model.dimension)) * size
    anywhere[:, -1] -= size[-1] / 2
    on_lines = anywhere.copy()
    on_lines[:, 0] = rng.choice(model.grid.lateral[0].at, len(anywhere))
    on_lines[::2, -1] = rng.choice(model.grid.levels, len(anywhere[::2]))
    return np.vstack([anywhere, on_lines, model.coordinates.T[::7]])


def test_it_finds_what_numpy_finds(model, monkeypatch):
    points = places(model)
    found = model.shape_functions(points)
    assert model._compiled is not None
    monkeypatch.setattr(model, "_compiled", None)
    plain = model.shape_functions(points)
    for one, other in zip(found, plain, strict=True):
        assert one.shape == other.shape
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    nodes, values, inside = found
    assert 0.2 < inside.mean() < 0.9
    where = np.einsum("kb,kbd->kd", values, model.coordinates.T[nodes])
    np.testing.assert_allclose(where[inside], points[inside], atol=1e-12)


def test_points_that_are_not_contiguous_do(model):
    points = places(model)
    turned = np.asfortranarray(points)
    for one, other in zip(
        model.shape_functions(points), model.shape_functions(turned), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("number", range(8))
def test_an_array_that_does_not_fit_is_refused(model, number):
    lines = model._compiled._lines
    points, each = np.zeros((5, model.dimension)), model._compiled._each
    outputs = np.empty((5, each), dtype=np.intp), np.empty((5, each)), np.empty(5, dtype=bool)
    arguments = [points, *lines, *outputs]
    compiled_grid._grid.shape_functions(*arguments)
    arguments[number] = np.zeros(1, dtype=np.float32)
    with pytest.raises((ValueError, TypeError)):
        compiled_grid._grid.shape_functions(*arguments)
    with pytest.raises(TypeError, match="8 arguments, not 7"):
        compiled_grid._grid.shape_functions(*arguments[:7])


def test_a_switch_keeps_to_numpy(model, monkeypatch):
    assert compiled_grid.available(model.grid)
    monkeypatch.setenv(compiled.SWITCH, "off")
    assert not compiled_grid.available(model.grid)
    assert TissueModel(model.scene)._compiled is None
