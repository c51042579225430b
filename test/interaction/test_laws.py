# SPDX-License-Identifier: Apache-2.0
"""Friction, cutting, puncture and relaxation, by place."""

import math

import numpy as np
import pytest

from needle_sim_ros.interaction.laws import Laws

SLAB = {
    "name": "slab",
    "shape": "box",
    "center": [0, 0, -0.03],
    "size": [1, 1, 0.02],
    "friction_static": 40.0,
    "friction_kinetic": 30.0,
    "cutting_force": 0.6,
}
LUMP = {
    "name": "lump",
    "shape": "box",
    "center": [0, 0, -0.03],
    "size": [0.01, 1, 0.01],
    "friction_kinetic": 15.0,
    "puncture_force": 0.9,
}


@pytest.fixture
def laws(coarse_scene):
    def make(changes=None):
        return Laws(coarse_scene(changes))

    return make


def test_friction_weakens_from_static_to_kinetic(laws):
    """Linear over 0.5 mm: half way, 0.25 mm, the mean of 16 and 14 N/m."""
    slip = np.array([0.0, 2.5e-4, 5e-4, 1e-2])
    found = laws().friction(np.full(4, 16.0), np.full(4, 14.0), slip)
    np.testing.assert_allclose(found, [16.0, 15.0, 14.0, 14.0], rtol=1e-14)


def test_cutting_without_ripple_is_constant(laws):
    assert laws().cutting(0.3, 0.0123) == 0.3


def test_cutting_ripple(laws):
    """F (1 + a sin 2 pi d / w): a quarter of the wave gives 1 + a, three quarters 1 - a."""
    ripple = {"amplitude": 0.2, "wavelength": 1e-3}
    rippled = laws({"interaction.cutting.ripple": ripple})
    found = [rippled.cutting(0.3, depth) for depth in (5e-3, 5.25e-3, 5.5e-3, 5.75e-3)]
    assert found == pytest.approx([0.3, 0.36, 0.3, 0.24], rel=1e-9)


def test_relaxation(laws):
    """exp(-t / T) with T = 1.5 s; two parts of a time are as good as the whole."""
    relaxed = laws().relaxed
    assert relaxed(0.3, 1.5) == pytest.approx(0.3 / math.e, rel=1e-14)
    assert relaxed(relaxed(0.3, 0.4), 0.7) == pytest.approx(relaxed(0.3, 1.1), rel=1e-14)


def test_outside_the_regions_the_scene_s_own_values_hold(laws):
    here = laws({"tissue.regions": [SLAB, LUMP]}).at(np.array([0.0, -0.01]))
    assert (here.static, here.kinetic, here.cutting, here.puncture) == (16.0, 14.0, 0.3, 0.5)


def test_a_region_changes_what_it_names(laws):
    """The slab cuts at 0.6 N: the puncture, never below the cutting, rises with it."""
    here = laws({"tissue.regions": [SLAB, LUMP]}).at(np.array([0.03, -0.03]))
    assert (here.static, here.kinetic, here.cutting, here.puncture) == (40.0, 30.0, 0.6, 0.6)


def test_the_last_region_wins(laws):
    both = laws({"tissue.regions": [SLAB, LUMP]}).at(np.array([0.0, -0.03]))
    assert (both.static, both.kinetic, both.cutting, both.puncture) == (40.0, 15.0, 0.6, 0.9)
    turned = laws({"tissue.regions": [LUMP, SLAB]}).at(np.array([0.0, -0.03]))
    assert (turned.kinetic, turned.puncture) == (30.0, 0.9)


def test_static_is_never_below_kinetic(laws):
    """Two regions, each fine with the scene, may leave static below kinetic where both lie."""
    low = {"name": "low", "shape": "box", "size": [1, 1, 1], "friction_static": 15.0}
    high = {"name": "high", "shape": "box", "size": [1, 1, 1], "friction_kinetic": 16.0}
    here = laws({"tissue.regions": [low, high]}).at(np.array([0.0, -0.03]))
    assert here.static >= here.kinetic == 16.0
