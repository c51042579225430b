# SPDX-License-Identifier: Apache-2.0
"""Elastic constants, and regions: their shapes, and that the last one wins."""

import numpy as np
import pytest

from needle_sim_ros.scene import Region
from needle_sim_ros.tissue.material import MaterialField, in_space, inside, lame_parameters


def test_lame_parameters_by_hand():
    """E = 10, nu = 0.25: mu = 4, lambda = 4; plane stress 2 mu lambda / (lambda + 2 mu) = 8/3."""
    assert lame_parameters(10.0, 0.25, "strain") == pytest.approx((4.0, 4.0))
    assert lame_parameters(10.0, 0.25, None) == pytest.approx((4.0, 4.0))
    assert lame_parameters(10.0, 0.25, "stress") == pytest.approx((8 / 3, 4.0))


CASES = [
    (
        Region("a", "box", center=(0.01, 0.0, -0.02), size=(0.01, 1.0, 0.02)),
        [(0.01, 0, -0.02), (0.0149, 0, -0.0299), (0.0051, 0, -0.0101)],
        [(0.0151, 0, -0.02), (0.01, 0, -0.031), (0.01, 0, -0.009), (0.01, 0.51, -0.02)],
    ),
    (
        Region("a", "ellipsoid", center=(0.0, 0.0, -0.03), size=(0.02, 0.02, 0.04)),
        [(0, 0, -0.03), (0.0099, 0, -0.03), (0, 0, -0.0499), (0.007, 0, -0.043)],
        [(0.0101, 0, -0.03), (0, 0, -0.0501), (0.008, 0, -0.043)],
    ),
    (
        Region("a", "half_space", center=(0.0, 0.0, -0.05), axis=(0.0, 0.0, 2.0)),
        [(0.05, 0, -0.06), (-0.05, 0, -0.0501)],
        [(0, 0, -0.0499), (0, 0, 0)],
    ),
    (
        # lies along x: 10 mm across, 40 mm long
        Region("a", "cylinder", center=(0, 0, -0.02), size=(0.01, 0.01, 0.04), axis=(3, 0, 0)),
        [(0.0199, 0, -0.02), (-0.0199, 0, -0.0249), (0, 0.0049, -0.02)],
        [(0.0201, 0, -0.02), (0, 0, -0.0251), (0, 0.0051, -0.02), (0, 0.004, -0.024)],
    ),
]


@pytest.mark.parametrize(
    ("region", "within", "without"), CASES, ids=lambda c: getattr(c, "shape", "")
)
def test_shapes(region, within, without):
    """Points hand-picked just inside and just outside the boundary."""
    assert inside(region, np.array(within, dtype=float).T).all()
    assert not inside(region, np.array(without, dtype=float).T).any()


def test_the_plane_is_y_0():
    np.testing.assert_array_equal(in_space(np.array([[1.0, 2], [3, 4]])), [[1, 2], [0, 0], [3, 4]])


def test_later_regions_win_and_null_keeps(coarse_scene):
    """Upper layer, then an inclusion in it; where both lie the inclusion's own keys count."""
    layer = {
        "name": "layer",
        "shape": "box",
        "center": [0, 0, -0.01],
        "size": [1, 1, 0.02],
        "youngs_modulus": 30e3,
        "density": 900.0,
    }
    inclusion = {
        "name": "lump",
        "shape": "ellipsoid",
        "center": [0, 0, -0.015],
        "size": [0.01, 0.01, 0.01],
        "youngs_modulus": 60e3,
    }
    field = MaterialField(coarse_scene({"tissue.regions": [layer, inclusion]}))
    places = np.array([[0.0, 0.03, 0.03], [-0.015, -0.015, -0.03]])
    material = field(places)
    np.testing.assert_allclose(material.shear, np.array([60e3, 30e3, 15e3]) / (2 * 1.49))
    np.testing.assert_allclose(material.density, [900.0, 900.0, 1000.0])
    turned = MaterialField(coarse_scene({"tissue.regions": [inclusion, layer]}))(places)
    np.testing.assert_allclose(turned.shear[0], 30e3 / (2 * 1.49))


def test_plane_stress_is_taken_in_2d(coarse_scene):
    places = np.array([[0.0], [-0.01]])
    stress = MaterialField(coarse_scene({"tissue.plane": "stress"}))(places)
    strain = MaterialField(coarse_scene())(places)
    assert stress.shear == pytest.approx(strain.shear)
    shear, lame = strain.shear[0], strain.lame[0]
    assert stress.lame[0] == pytest.approx(2 * shear * lame / (lame + 2 * shear))
