# SPDX-License-Identifier: Apache-2.0
"""A run as arrays: shapes, order and refusals."""

from types import SimpleNamespace

import numpy as np
import pytest

from needle_sim_ros.errors import SessionError
from needle_sim_ros.interaction.process import Process
from needle_sim_ros.scene import Scene
from needle_sim_ros.session.series import Series


def observation(k: int, markers: int = 2) -> SimpleNamespace:
    rng = np.random.default_rng(k)
    reference = np.arange(3.0 * markers).reshape(markers, 3)
    displacement = rng.normal(size=(markers, 3))
    return SimpleNamespace(
        time=0.01 * (k + 1),
        process=Process.INSERTION if k else Process.FREE,
        insertion_depth=1e-3 * k,
        tip_position=rng.normal(size=3),
        tip_deflection=rng.normal(size=3),
        base_position=rng.normal(size=3),
        base_orientation=np.array([1.0, 0.0, 0.0, 0.0]),
        base_force=rng.normal(size=3),
        base_torque=rng.normal(size=3),
        friction_force=float(k),
        tip_force=2.0 * k,
        marker_positions=reference + displacement,
        marker_displacements=displacement,
    )


def test_every_member_keeps_the_order_of_the_observations():
    observations = [observation(k) for k in range(4)]
    scene = Scene.load("gao2016")
    series = Series.from_observations(iter(observations), scene, {"package_version": "0"})
    assert len(series) == 4
    for name in ("time", "insertion_depth", "base_force", "base_torque", "tip_position"):
        expected = [getattr(o, name) for o in observations]
        np.testing.assert_array_equal(getattr(series, name), expected)
    for name in ("tip_deflection", "base_position", "base_orientation", "tip_force"):
        expected = [getattr(o, name) for o in observations]
        np.testing.assert_array_equal(getattr(series, name), expected)
    assert series.process == ["free", "insertion", "insertion", "insertion"]
    np.testing.assert_allclose(series.marker_reference, np.arange(6.0).reshape(2, 3), atol=1e-15)
    np.testing.assert_allclose(
        series.marker_positions, [o.marker_positions for o in observations], atol=1e-15
    )
    assert Scene.from_yaml(series.scene_text) == scene
    assert series.metadata == {"package_version": "0"}


@pytest.mark.parametrize("ticks, markers", [(0, 0), (3, 0), (1, 5)])
def test_few_ticks_and_no_markers_keep_their_dimensions(ticks, markers):
    series = Series.from_observations(observation(k, markers) for k in range(ticks))
    assert series.base_force.shape == (ticks, 3)
    assert series.marker_displacements.shape == (ticks, markers if ticks else 0, 3)
    assert series.marker_positions.shape == series.marker_displacements.shape


def test_arrays_of_unequal_length_are_refused_by_name():
    series = Series.from_observations(observation(k) for k in range(2))
    members = {**vars(series), "base_torque": np.zeros((3, 3))}
    with pytest.raises(SessionError, match=r"base_torque has shape \(3, 3\): must be \(2, 3\)"):
        Series(**members)
