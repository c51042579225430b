# SPDX-License-Identifier: Apache-2.0
"""Rotations against scipy's, which the hot path is too often in to call."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from needle_sim_ros import geometry
from needle_sim_ros.interaction.pose import BasePose

vectors = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@given(vectors, vectors)
def test_rotations_are_those_of_scipy(a, b):
    p, q = geometry.from_rotation_vector(a), geometry.from_rotation_vector(b)
    theirs = Rotation.from_rotvec(a) * Rotation.from_rotvec(b)
    product = geometry.multiply(p, q)
    matrix = geometry.rotation_matrix(product)
    np.testing.assert_allclose(matrix, theirs.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(
        geometry.multiply(p, geometry.conjugate(p)), [0, 0, 0, 1], atol=1e-12
    )


@given(vectors)
def test_rotation_vectors_come_back_the_short_way(v):
    angle = np.linalg.norm(v)
    back = geometry.to_rotation_vector(geometry.from_rotation_vector(v))
    if angle < np.pi - 1e-6:
        np.testing.assert_allclose(back, v, atol=1e-9)
    else:
        assert np.linalg.norm(back) <= np.pi + 1e-9


@given(vectors, st.floats(1e-3, 2.0))
def test_turning_is_a_rotation_about_the_world_axis(rate, duration):
    start = geometry.from_rotation_vector([0.3, -0.2, 0.9])
    turned = geometry.turn(start, rate, duration)
    theirs = Rotation.from_rotvec(rate * duration) * Rotation.from_quat(start)
    np.testing.assert_allclose(geometry.rotation_matrix(turned), theirs.as_matrix(), atol=1e-12)


@given(st.floats(-1.2, 1.2), st.tuples(st.floats(-0.1, 0.1), st.floats(0.05, 0.2)))
def test_base_axes_are_eq_12(angle, place):
    """Vertical needle turned by theta about y: axes as the columns of R_e, Eq. (12), up to
    the names: the paper's x is our axis, its y our base x."""
    turn = geometry.from_rotation_vector([0, angle, 0])
    quaternion = geometry.multiply(turn, [1.0, 0.0, 0.0, 0.0])
    pose = BasePose.of(np.array([place[0], 0.0, place[1]]), quaternion, 2)
    np.testing.assert_allclose(pose.axial, [-np.sin(angle), -np.cos(angle)], atol=1e-12)
    np.testing.assert_allclose(pose.lateral[0], [np.cos(angle), -np.sin(angle)], atol=1e-12)
    ahead = pose.origin + 0.07 * pose.axial + 0.002 * pose.lateral[0]
    assert abs(pose.along(ahead) - 0.07) < 1e-12
    np.testing.assert_allclose(pose.aside(ahead), [0.002], atol=1e-12)
