# SPDX-License-Identifier: Apache-2.0
"""What friction remembers of the slip: it grows with the way and heals with time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_sim_ros.interaction.friction import FrictionMemory, FrictionStart, slip_after
from needle_sim_ros.interaction.laws import Laws
from needle_sim_ros.scene import Scene

SLIDES, STICKS = np.array([1], dtype=np.int8), np.array([0], dtype=np.int8)


@pytest.fixture(scope="module")
def laws():
    scene = Scene.load("gao2016").with_changes(
        {
            "interaction.friction.weakening_distance": 4e-4,
            "interaction.friction.healing_time": 0.2,
        }
    )
    return Laws(scene)


def after(laws, slip, status, slid, duration):
    return float(slip_after(laws, np.array([slip]), status, np.array([slid]), duration)[0])


def test_slip_grows_with_the_way_up_to_the_weakening_distance(laws):
    """Either way alike; kinetic friction cannot become more kinetic."""
    assert after(laws, 1e-4, SLIDES, 2e-4, 0.01) == pytest.approx(3e-4, rel=1e-5)
    assert after(laws, 1e-4, -SLIDES, -2e-4, 0.01) == pytest.approx(3e-4, rel=1e-5)
    assert after(laws, 3e-4, SLIDES, 2e-4, 0.01) == 4e-4


def test_slip_heals_while_a_point_rests(laws):
    """Stuck, or at its limit without moving: with the healing time."""
    healed = 4e-4 * np.exp(-0.1 / 0.2)
    assert after(laws, 4e-4, STICKS, 0.0, 0.1) == pytest.approx(healed, rel=1e-12)
    assert after(laws, 4e-4, SLIDES, 0.0, 0.1) == pytest.approx(healed, rel=1e-12)


@given(
    slip=st.floats(0, 4e-4),
    rests=st.floats(1e-4, 1.0),
    parts=st.integers(1, 50),
    status=st.sampled_from([STICKS, SLIDES, -SLIDES]),
)
def test_how_finely_a_rest_is_divided_does_not_matter(laws, slip, rests, parts, status):
    """The same slip is left after one step and after many short ones."""
    left = slip
    for _ in range(parts):
        left = after(laws, left, status, 0.0, rests / parts)
    assert left == pytest.approx(after(laws, slip, status, 0.0, rests), rel=1e-9, abs=1e-15)


@given(
    slip=st.floats(0, 4e-4),
    way=st.floats(-1e-6, 1e-6),
    duration=st.floats(1e-7, 1e-5),
    status=st.sampled_from([STICKS, SLIDES, -SLIDES]),
)
def test_what_lasts_an_instant_leaves_no_mark(laws, slip, way, duration, status):
    """However the friction turns: the slip changes by the way and the time that passed."""
    change = abs(after(laws, slip, status, way, duration) - slip)
    assert change <= (abs(way) + slip * duration / 0.2) * (1 + 1e-9) + 1e-18


def test_slow_sliding_is_between_static_and_kinetic(laws):
    """At a thousandth of the weakening distance in the healing time it heals half as fast."""
    creep = 1e-3 * 4e-4 / 0.2
    slip = 0.0
    for _ in range(100):
        slip = after(laws, slip, SLIDES, 0.1 * creep, 0.1)
    assert slip == pytest.approx(2 * creep * 0.2, rel=1e-6)
    for _ in range(100):
        slip = after(laws, slip, SLIDES, 0.1 * 100 * creep, 0.1)
    assert slip == 4e-4


@given(st.floats(-1e-3, 1e-3), st.floats(1e-4, 1.0), st.floats(-1e-3, 1e-3), st.floats(1e-4, 1.0))
def test_what_the_needle_drags_goes_by_its_advance_all_else_by_time(before, lasted, advance, lasts):
    memory = FrictionMemory(np.zeros(2), np.zeros(2), np.array([1e-4, -2e-4]), before, lasted)
    status = np.array([1, -1], dtype=np.int8)
    start = FrictionStart(
        np.ones(2),
        np.ones(2),
        memory.slip,
        memory.strain,
        status,
        advance,
        memory.slid,
        memory.pace(advance),
        memory.lapse(lasts),
        lasts,
    )
    dragged = advance / before if advance * before > 0 else 0.0
    expected = [dragged if sign * advance > 0 else lasts / lasted for sign in (1, -1)]
    np.testing.assert_allclose(start.onward, memory.slid * expected, rtol=1e-12)


def test_nothing_lasted_before_the_first_step():
    assert FrictionMemory(*np.zeros((3, 0)), 0.0, 0.0).lapse(0.01) == 1.0
