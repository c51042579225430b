# SPDX-License-Identifier: Apache-2.0
"""The slowest wave of a tissue: of the softest of its parts."""

import numpy as np
import pytest

from needle_sim_ros.scene import Scene
from needle_sim_ros.tissue.waves import slowest_period


def test_a_quarter_of_the_wave_stands_in_the_depth():
    tissue = Scene.load("gao2016").tissue
    speed = np.sqrt(tissue.youngs_modulus / (2 * (1 + tissue.poisson_ratio)) / tissue.density)
    assert slowest_period(tissue) == pytest.approx(4 * tissue.size[-1] / speed, rel=1e-12)


def test_the_softest_part_counts():
    scene = Scene.load("layered_inclusion")
    softest = min([scene.tissue.youngs_modulus, *(r.youngs_modulus for r in scene.tissue.regions)])
    plain = scene.with_changes({"tissue.youngs_modulus": softest, "tissue.regions": []}).tissue
    assert slowest_period(scene.tissue) == pytest.approx(slowest_period(plain), rel=1e-12)
