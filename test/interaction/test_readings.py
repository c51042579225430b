# SPDX-License-Identifier: Apache-2.0
"""What a needle reads: by hand, compiled and by numpy, and in the plane as in space."""

import numpy as np
import pytest

from needle_sim_ros.interaction import readings as module
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.readings import readings
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.track import Track
from needle_sim_ros.needle import beam

HELD, LAID = 7, 11
LENGTH, RIGIDITY, TIP = 0.1, 0.02, 0.7
TURNED = np.array([0.2, -0.5, 0.3, 0.7]) / np.linalg.norm([0.2, -0.5, 0.3, 0.7])


@pytest.fixture(params=[True, False], ids=["compiled", "numpy"])
def either(request, monkeypatch):
    if request.param and module._readings is None:
        pytest.skip("built without a compiler")
    monkeypatch.setattr(module, "_COMPILED", request.param)


@pytest.fixture(params=[2, 3], ids=["2D", "3D"])
def held(request):
    """A needle held by seven points, with two more of them rubbing ahead of its tip."""
    d, rng = request.param, np.random.default_rng(7)
    none = np.empty(0)
    track = Track(1e-3, rng.normal(size=(LAID, d)), none, none, None, none)
    contact = ContactState(
        track=track,
        inserted=True,
        active=HELD + 2,
        lateral=rng.normal(size=(d - 1, HELD)),
        friction=rng.normal(size=HELD + 2),
        tip=TIP,
        arclength=rng.uniform(0.05, 0.1, HELD),
        softness=rng.uniform(0, 1, HELD),
        moved=rng.normal(size=(LAID, d)),
    )
    turned = TURNED if d == 3 else np.array([0.0, np.sin(0.2), 0.0, np.cos(0.2)])
    return contact, BasePose.of(np.array([0.01, 0.02, 0.03]), turned, d)


def in_space(pose, vector):
    """Put a vector of the mesh into the world."""
    return vector if len(vector) == 3 else np.array([vector[0], 0.0, vector[1]])


def axes(pose):
    """The base's axes x, y, z in the world; in the plane y is that of the world."""
    if len(pose.axial) == 3:
        return [*pose.lateral, pose.axial]
    return [in_space(pose, pose.lateral[0]), np.array([0, 1.0, 0]), in_space(pose, pose.axial)]


def test_the_tip_is_where_the_cantilever_bends_it(either, held):
    contact, pose = held
    found = readings(contact, pose, LENGTH, RIGIDITY)
    at = np.array([LENGTH])
    bent = -(contact.lateral @ beam.flexibility(at, contact.arclength, RIGIDITY)[0])
    slope = -(contact.lateral @ beam.tip_slope_flexibility(contact.arclength, RIGIDITY))
    m = len(bent)
    np.testing.assert_allclose(found.tip_deflection, [*bent, *[0.0] * (3 - m)], rtol=1e-12)
    np.testing.assert_allclose(found.tip_slope, [*slope, *[0.0] * (2 - m)], rtol=1e-12)
    place = pose.origin + LENGTH * pose.axial + bent @ pose.lateral
    np.testing.assert_allclose(found.tip_position, in_space(pose, place), rtol=1e-12, atol=1e-15)


def test_force_and_torque_are_those_of_every_force_by_itself(either, held):
    """F = -(forces on the tissue) and r x F about the base, point by point in the world."""
    contact, pose = held
    found = readings(contact, pose, LENGTH, RIGIDITY)
    x, y, z = axes(pose)
    base = in_space(pose, pose.origin)
    force, torque = np.zeros(3), np.zeros(3)
    for k in range(HELD):
        # the arm: across, where the track holds it; along, its arclength
        at = in_space(pose, contact.track.points[k] + contact.moved[k]) - base
        sideways = [contact.softness[k] * q for q in (*contact.lateral[:, k], 0.0)[:2]]
        arm = (at @ x + sideways[0]) * x + contact.arclength[k] * z
        own = -contact.lateral[0, k] * x - contact.friction[k] * z
        if len(contact.lateral) == 2:
            arm = arm + (at @ y + sideways[1]) * y
            own = own - contact.lateral[1, k] * y
        force, torque = force + own, torque + np.cross(arm, own)
    ahead = -(contact.friction[HELD:].sum() + TIP) * z
    dx, dy, _ = found.tip_deflection
    force, torque = force + ahead, torque + np.cross(dx * x + dy * y + LENGTH * z, ahead)
    np.testing.assert_allclose(found.base_force, [force @ e for e in (x, y, z)], atol=1e-12)
    np.testing.assert_allclose(found.base_torque, [torque @ e for e in (x, y, z)], atol=1e-12)
    assert found.friction_force == pytest.approx(contact.friction.sum(), rel=1e-12)


def test_layout_does_not_matter(either, held):
    contact, pose = held
    other = contact._replace(
        lateral=np.asfortranarray(contact.lateral), friction=np.repeat(contact.friction, 2)[::2]
    )
    found = readings(other, pose, LENGTH, RIGIDITY)
    expected = readings(contact, pose, LENGTH, RIGIDITY)
    for one, same in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, same, rtol=1e-12, atol=1e-13)


def test_compiled_and_numpy_read_the_same(held, monkeypatch):
    if module._readings is None:
        pytest.skip("built without a compiler")
    contact, pose = held
    found = readings(contact, pose, LENGTH, RIGIDITY)
    monkeypatch.setattr(module, "_COMPILED", False)
    for one, same in zip(found, readings(contact, pose, LENGTH, RIGIDITY), strict=True):
        np.testing.assert_allclose(one, same, rtol=1e-12, atol=1e-13)


def test_a_tip_that_touches_neither_rubs_nor_twists(either, held):
    """Only its own force counts: bent by it, and pushed by it where it is."""
    contact, pose = held
    one = contact._replace(
        touching=True,
        active=1,
        lateral=contact.lateral[:, :1],
        friction=np.zeros(1),
        arclength=np.array([LENGTH]),
        softness=np.zeros(1),
    )
    found = readings(one, pose, LENGTH, RIGIDITY)
    assert (found.base_torque[2], found.friction_force) == (0.0, 0.0)
    q, m = one.lateral[:, 0], len(one.lateral)
    bent = -q * LENGTH**3 / (3 * RIGIDITY)
    np.testing.assert_allclose(found.tip_deflection[:m], bent, rtol=1e-12)
    np.testing.assert_allclose(found.base_force, [*-q, *[0.0] * (2 - m), -TIP], rtol=1e-12)
    assert found.base_torque[1] == pytest.approx(-q[0] * LENGTH + bent[0] * TIP, rel=1e-12)


def test_a_free_needle_is_straight(either, held):
    _, pose = held
    d = len(pose.axial)
    found = readings(ContactState(lateral=np.empty((d - 1, 0))), pose, LENGTH, RIGIDITY)
    place = in_space(pose, pose.origin + LENGTH * pose.axial)
    np.testing.assert_allclose(found.tip_position, place, rtol=1e-15)
    for other in (*found[:2], *found[3:]):
        assert not np.any(other)


def test_arrays_that_do_not_fit_are_refused(held):
    if module._readings is None:
        pytest.skip("built without a compiler")
    contact, pose = held
    short = contact.track._replace(points=np.zeros((1, len(pose.axial))))
    with pytest.raises(ValueError, match="points"):
        readings(contact._replace(track=short), pose, LENGTH, RIGIDITY)
    with pytest.raises(TypeError, match="12 arguments"):
        module._readings.readings()
