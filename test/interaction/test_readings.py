# SPDX-License-Identifier: Apache-2.0
"""What forces add up to: by hand, compiled and by numpy, and in the plane as in space."""

import numpy as np
import pytest

from needle_sim_ros.interaction import resultants as module
from needle_sim_ros.interaction.pose import BasePose
from needle_sim_ros.interaction.resultants import resultants
from needle_sim_ros.interaction.state import ContactState
from needle_sim_ros.interaction.track import Track

HELD, LAID = 7, 11
TURNED = np.array([0.2, -0.5, 0.3, 0.7]) / np.linalg.norm([0.2, -0.5, 0.3, 0.7])


@pytest.fixture(params=[True, False], ids=["compiled", "numpy"])
def either(request, monkeypatch):
    if request.param and module._resultants is None:
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
        arclength=rng.uniform(0.05, 0.1, HELD),
        softness=rng.uniform(0, 1, HELD),
        moved=rng.normal(size=(LAID, d)),
    )
    turned = TURNED if d == 3 else np.array([0.0, np.sin(0.2), 0.0, np.cos(0.2)])
    return contact, BasePose.of(np.array([0.01, 0.02, 0.03]), turned, d)


def test_sums_are_those_of_every_force_by_itself(either, held):
    contact, pose = held
    found = resultants(contact, pose)
    points, q, f = contact.track.points + contact.moved, contact.lateral, contact.friction
    for a, axis in enumerate(pose.lateral):
        powers = [sum(q[a, k] * contact.arclength[k] ** n for k in range(HELD)) for n in range(4)]
        np.testing.assert_allclose(found.moments[a], powers, rtol=1e-12, atol=1e-15)
        bent = [
            axis @ (points[k] - pose.origin) + contact.softness[k] * q[a, k] for k in range(HELD)
        ]
        rubbing = sum(f[k] * bent[k] for k in range(HELD))
        assert found.rubbing[a] == pytest.approx(rubbing, rel=1e-12, abs=1e-13)
    assert found.friction == pytest.approx(sum(f), rel=1e-12, abs=1e-14)
    assert found.beyond == pytest.approx(f[-2] + f[-1], rel=1e-12, abs=1e-14)


def test_the_twist_is_the_torque_about_the_axis(either, held):
    """r x F of every point by the cross product; none in the plane."""
    contact, pose = held
    if len(pose.axial) == 2:
        assert resultants(contact, pose).twist == 0.0
        return
    twist = 0.0
    for k in range(HELD):
        at = pose.aside(contact.track.points[k] + contact.moved[k])
        at = at + contact.softness[k] * contact.lateral[:, k]
        twist += np.cross([*at, 0.0], [*-contact.lateral[:, k], 0.0])[2]
    assert resultants(contact, pose).twist == pytest.approx(twist, rel=1e-12, abs=1e-13)


def test_layout_does_not_matter(either, held):
    contact, pose = held
    other = contact._replace(
        lateral=np.asfortranarray(contact.lateral), friction=np.repeat(contact.friction, 2)[::2]
    )
    found, expected = resultants(other, pose), resultants(contact, pose)
    for one, same in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, same, rtol=1e-12, atol=1e-13)


def test_a_tip_that_touches_neither_rubs_nor_twists(either, held):
    contact, pose = held
    one = contact._replace(
        touching=True,
        lateral=contact.lateral[:, :1],
        friction=np.zeros(1),
        arclength=contact.arclength[:1],
        softness=np.zeros(1),
    )
    found = resultants(one, pose)
    assert found.rubbing == [0.0] * len(pose.lateral)
    assert (found.twist, found.friction, found.beyond) == (0.0, 0.0, 0.0)
    np.testing.assert_allclose([m[0] for m in found.moments], one.lateral[:, 0])


def test_arrays_that_do_not_fit_are_refused(held):
    if module._resultants is None:
        pytest.skip("built without a compiler")
    contact, pose = held
    with pytest.raises(ValueError, match="points"):
        resultants(
            contact._replace(track=contact.track._replace(points=np.zeros((1, len(pose.axial))))),
            pose,
        )
    with pytest.raises(TypeError, match="8 arguments"):
        module._resultants.resultants()
